"""A request's form, read within bounds and in memory: nothing of it touches the disk."""

from collections.abc import AsyncGenerator, Callable

from starlette.datastructures import UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import ClientDisconnect, Request

from omad.common.errors import InputError, shown
from omad.common.files import one_line
from omad.common.limits import limits

PARTS = 24
"""Of a form; there are half as many fields."""


class TooLarge(Exception):
    """A body beyond the service's limit."""


class Full(Exception):
    """More bytes of bodies than the service holds at a time."""


class Gone(Exception):
    """Who asked left before the body was there."""


class _InMemory(MultiPartParser):
    spool_max_size = 2**62
    ended = False
    # whatever a client names: some decoders take quadratic time, in which nobody else is answered, and some raise
    _charset = property(lambda _: "utf-8", lambda *_: None)  # type: ignore[assignment]

    def on_part_data(self, data: bytes, start: int, end: int) -> None:
        try:
            super().on_part_data(data, start, end)
        except MultiPartException as error:
            what = f"is a text of more than {self.max_part_size} bytes; send a file as one, with curl as name=@file"
            raise InputError(f"{shown(self._current_part.field_name)}: {what}") from error

    def on_end(self) -> None:
        self.ended = True


async def read_form(request: Request, most: int, take: Callable[[int], None]) -> dict[str, bytes]:
    """The fields of a multipart form of up to ``most`` bytes, files as they came; ``take`` is told of how many come.
    Raises InputError, TooLarge and Gone, and what ``take`` does."""
    kind = request.headers.get("content-type", "")
    if kind.split(";")[0].strip().lower() != "multipart/form-data":
        raise InputError("the body is no form; send multipart/form-data with depth and intrinsics (curl -F)")
    length = request.headers.get("content-length", "0")
    if length.isdigit() and (len(length) > 15 or int(length) > most):
        raise TooLarge
    parser = _InMemory(
        request.headers, _bounded(request, most, take), max_files=PARTS, max_fields=PARTS,
        max_part_size=limits().camera_bytes,
    )  # fmt: skip
    try:
        form = await parser.parse()
    except MultiPartException as error:
        raise InputError(f"the body is no form ({shown(one_line(error))}); send it anew") from error
    except ClientDisconnect as error:
        raise Gone from error
    if not parser.ended:  # a field that was cut would seem not to have been sent
        raise InputError("the body ends before its form does; send it anew")
    told: dict[str, bytes] = {}
    for name, value in form.multi_items():
        if name in told:
            raise InputError(f"{shown(name)}: is there twice; give it once")
        told[name] = await value.read() if isinstance(value, UploadFile) else value.encode(errors="replace")
    return told


async def _bounded(request: Request, most: int, take: Callable[[int], None]) -> AsyncGenerator[bytes, None]:
    seen = 0
    async for chunk in request.stream():
        seen += len(chunk)
        if seen > most:
            raise TooLarge
        take(len(chunk))
        yield chunk
