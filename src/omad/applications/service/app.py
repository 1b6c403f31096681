"""The service's addresses: POST /estimate, and GET /health and /metrics."""

from typing import Any

from fastapi import FastAPI, Request, Response
from starlette.exceptions import HTTPException

import omad

from .asked import CHECKS, FORMATS, SEGMENTS
from .bounded import Service
from .reply import Reply

THERE = "there are POST /estimate, GET /health, GET /metrics and GET /openapi.json"
RETRY = 1
"""Seconds after which who was turned away may come again."""


_FILE, _TEXT = {"type": "string", "format": "binary"}, {"type": "string"}
_FIELDS = {
    "depth": {**_FILE, "description": "16-bit PNG, TIFF or PGM, PFM, NPY or NPZ"},
    "intrinsics": {**_TEXT, "description": "fx,fy,cx,cy of the depth camera, or what its file holds"},
    "category": {**_TEXT, "default": "auto", "description": "one that is served; auto: the one that explains it best"},
    "mask": {**_FILE, "description": "not zero on the object, or COCO's JSON; without, the object is looked for"},
    "mask_id": {"type": "integer", "description": "the object's number in a mask that is a label image"},
    "box": {**_TEXT, "description": "x1,y1,x2,y2 in pixels around the object, half-open"},
    "segment": {**_TEXT, "enum": SEGMENTS},
    "depth_scale": {"type": "number", "description": "metres per stored number; default 0.001 for integers"},
    "drop_flying": {"type": "boolean", "default": False},
    "checks": {**_TEXT, "enum": CHECKS, "default": "all", "description": "few: without those that estimate again"},
    "format": {**_TEXT, "enum": FORMATS, "default": "json", "description": "html (or Accept: text/html): the page"},
}
_FORM = {"schema": {"type": "object", "required": ["depth", "intrinsics"], "properties": _FIELDS}}
_SAYS = {
    400: "the one line that says what is wrong",
    403: "a page of another site asks, or for a name that is not this machine's",
    408: "the body came too slowly",
    413: "the body is too large",
    500: "the work failed; the log says more",
    503: "as many requests, or bytes of them, as are taken on are here already",
    504: "no answer in time",
}


def make_app(service: Service) -> FastAPI:
    """The application for a server. Its description is at /openapi.json."""
    about = "Shape, pose, joint states and joint axes of articulated objects. Metres, radians, camera frame."
    app = FastAPI(
        title="OMAD", version=omad.__version__, description=about, docs_url=None, redoc_url=None, redirect_slashes=False
    )
    body = {"requestBody": {"required": True, "content": {"multipart/form-data": _FORM}}}
    said: dict[int | str, dict[str, Any]] = {status: {"description": what} for status, what in _SAYS.items()}

    @app.exception_handler(HTTPException)
    async def failed(_: Request, error: HTTPException) -> Response:
        """Of an address or a method that there is not, in the words of all errors."""
        reply = Reply.failed(error.status_code, f"{error.detail}; {THERE}")
        return Response(reply.body, reply.status, error.headers, reply.media_type)

    @app.post("/estimate", openapi_extra=body, responses=said, response_class=Response)
    async def estimate(request: Request) -> Response:
        """The JSON of omad estimate for one depth image, or its page."""
        reply = await service.estimate(request)
        retry = {"Retry-After": str(RETRY)} if reply.status == 503 else {}
        return Response(reply.body, reply.status, retry, reply.media_type)

    @app.get("/health")
    @app.head("/health", include_in_schema=False)
    async def health() -> dict[str, object]:
        """That it answers, and with what."""
        return {"status": "ok", "version": omad.__version__, "categories": service.answers.categories}

    @app.get("/metrics")
    @app.head("/metrics", include_in_schema=False)
    async def metrics() -> Response:
        """Counts, for Prometheus."""
        batcher = service.batcher
        counts = {"requests_inside": service.inside, "requests_waiting": batcher.waiting, "bytes_held": service.held}
        text = service.metrics.text(**counts, batches_total=batcher.batches)
        return Response(text, media_type="text/plain; version=0.0.4")

    return app
