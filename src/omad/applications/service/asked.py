"""What one request asks: a depth image as bytes, and how to read it. Readers and limits are those of files."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from io import BytesIO
from typing import Any, Self, TypeVar

import numpy as np

from omad.common.errors import InputError, shown
from omad.common.limits import check_limit
from omad.objects.builtin import AUTO
from omad.sensing.beside import scale_in_text
from omad.sensing.camera_files import parse_camera
from omad.sensing.depth_files import parse_depth, parse_mask, parse_own_mask
from omad.sensing.observation import Observation
from omad.sensing.reader import Find, InputReader, parse_numbers

CHECKS = ("all", "few")
SEGMENTS = ("plane",)
FORMATS = ("json", "html")
PNG_MAGIC = b"\x89PNG"
A_NAME = 4096
"""Bytes: what is shorter, and text, is the name of a file that was not sent."""
HERE = {
    r",? or (on the command line )?--[a-z-]+[^,;:)]*": "",
    r",? or raise the limit with OMAD_LIMITS=[^,;:)]*": "",
    r"\bomad estimate a mask": "a mask",
    r"\bestimate\.html": "the page (format html)",
    r"\blook at estimate\.png[^;]{0,300}; ": "",
}
"""Of patterns in what is said of the command line: what a request has in place of it, where it has anything."""
T = TypeVar("T")


@dataclass(frozen=True)
class Asked:
    """The fields of a request, by their names."""

    depth: bytes
    """A file's bytes: 16-bit PNG, TIFF or PGM, PFM, NPY or NPZ."""
    intrinsics: str
    """fx,fy,cx,cy, or what a camera's file holds."""
    category: str = AUTO
    """One that is served; auto: the one that explains the image best."""
    mask: bytes | None = None
    """A file's bytes, as ``read_mask`` reads it; without, the object is looked for."""
    mask_id: int | None = None
    box: list[float] | None = None
    segment: str | None = None
    depth_scale: float | None = None
    """Metres per stored number."""
    drop_flying: bool = False
    checks: str = "all"
    """few: without those that take further estimates."""
    format: str = "json"
    """html: the page."""

    @classmethod
    def of(cls, told: Mapping[str, bytes]) -> Self:
        """Raises InputError that names the field."""
        known = [field.name for field in fields(cls)]
        if unknown := [name for name in told if name not in known]:
            raise InputError(f"{shown(unknown[0])}: no such field; there are {', '.join(known)}")
        for name, what in (("depth", "a depth image's file"), ("intrinsics", "fx,fy,cx,cy or a camera's file")):
            if not told.get(name):
                raise InputError(f"{name}: is missing; give {what}")
        if told.get("mask") == b"":
            raise InputError("mask: is an empty file; send a mask, or leave it out")
        texts = {name: _text(name, value) for name, value in told.items() if name not in ("depth", "mask")}
        read: dict[str, Any] = {name: texts[name] for name in ("intrinsics", "category") if name in texts}
        for name, among in (("segment", SEGMENTS), ("checks", CHECKS), ("format", FORMATS)):
            if name in texts:
                read[name] = _one_of(name, texts[name], {each: each for each in among})
        if "drop_flying" in texts:
            read["drop_flying"] = _one_of("drop_flying", texts["drop_flying"].lower(), {"true": True, "false": False})
        if "box" in texts:
            read["box"] = parse_numbers(texts["box"], 4, "box")
        for name, kind, what in (("mask_id", int, "a whole number"), ("depth_scale", float, "a number")):
            if name in texts:
                read[name] = _number(name, texts[name], kind, what)
        return cls(told["depth"], mask=told.get("mask"), **read)

    def observation(self, find: Find) -> Observation:
        """The object's points; ``find`` cuts it out where nothing tells which it is. Raises InputError."""
        if len(self.depth) < A_NAME and self.depth.isascii() and self.depth.decode().isprintable():
            raise InputError("depth: not readable as an image; send the file itself, with curl as depth=@depth.png")
        reader, mask = self._reader(find), self._mask()
        if mask is None:
            reader.check_mask_id()
        metres_per_integer = reader.metres_per_integer(self._scale_in_text())
        return reader.observe(parse_depth(self.depth, "depth", self.depth_scale, metres_per_integer), mask)

    def _scale_in_text(self) -> float | None:
        return scale_in_text(BytesIO(self.depth), "depth")

    def _reader(self, find: Find | None = None) -> InputReader:
        camera, segment = parse_camera(self.intrinsics, "intrinsics"), "plane" if self.segment else None
        held = {"drop_flying": self.drop_flying, "mask_id": self.mask_id, "find": find}
        return InputReader(camera, None, self.box, segment, self.depth_scale, **held)

    def _mask(self) -> np.ndarray | None:
        """That which was sent, or lies in the depth image's file where nothing else says where the object is."""
        if self.mask is not None:
            return parse_mask(self.mask, "mask", self.mask_id)
        told = self.box is not None or self.segment is not None
        return None if told else parse_own_mask(self.depth, "depth", self.mask_id)

    @property
    def size(self) -> int:
        """Bytes of its files."""
        return len(self.depth) + len(self.intrinsics) + len(self.mask or b"")

    @property
    def metres_per_number(self) -> float | None:
        """Of the image, where that can be told without its numbers."""
        integers = self.depth.startswith(PNG_MAGIC)
        return self.depth_scale or (self._reader().metres_per_integer(self._scale_in_text()) if integers else None)


def in_fields(message: str) -> str:
    """What is said of the command line's options and files, said of a request's fields; options that are no field are
    not offered."""
    for name in Asked.__dataclass_fields__:
        option = f"--{name.replace('_', '-')}"
        message = re.sub(rf"({name} \({option}\)|(on the command line:? )?{option})(?![\w-])", name, message)
    for pattern, here in HERE.items():
        message = re.sub(pattern, here, message)
    return message


def _text(name: str, value: bytes) -> str:
    check_limit("camera_bytes", len(value), f"{name}: the text")
    try:
        return value.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: is no text; give it as UTF-8") from error


def _one_of(name: str, value: str, known: Mapping[str, T]) -> T:
    if value not in known:
        raise InputError(f"{name} {shown(repr(value))}: give {' or '.join(known)}")
    return known[value]


def _number(name: str, value: str, kind: type, what: str) -> Any:
    try:
        return kind(value)
    except ValueError as error:
        raise InputError(f"{name} {shown(repr(value))}: give {what}") from error
