"""LZF, as compressed PCD files have it (libLZF): runs of bytes as they are, and copies of what came before."""

AS_THEY_ARE = 32
"""Bytes below this begin a run of so many bytes, and one."""
LONG = 7
"""A copy's length that says that the next byte tells more of it."""


def decompressed(data: bytes, size: int) -> bytes:
    """``size`` bytes. Raises ValueError or IndexError where ``data`` is cut short or makes others."""
    made, at = bytearray(), 0
    while at < len(data) and len(made) <= size:
        told = data[at]
        at += 1
        if told < AS_THEY_ARE:
            made += data[at : at + told + 1]
            at += told + 1
            continue
        length = told >> 5
        if length == LONG:
            length += data[at]
            at += 1
        length += 2
        begin = len(made) - ((told & 31) << 8) - data[at] - 1
        at += 1
        if begin < 0:
            raise ValueError("a copy of what is not there")
        some = made[begin : begin + length]
        made += (some * -(-length // len(some)))[:length]  # it may go on into what it makes
    if len(made) != size:
        raise ValueError("not the bytes that were told")
    return bytes(made)
