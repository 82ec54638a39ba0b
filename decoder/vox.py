"""MagicaVoxel .vox files: one model of coloured voxels, read and written."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decoder.design import DesignError

MAGIC = b"VOX "
VERSION = 150
LARGEST = 256  # voxels along a side that the format can address
_HEADER = struct.Struct("<4sII")  # chunk id, bytes of content, bytes of children
Colour = tuple[int, int, int, int]


@dataclass(frozen=True, eq=False, slots=True)
class VoxModel:
    """One painted model.

    Attributes:
        index: palette index of every voxel, 0 where there is none, shape (x, y, z), u8; z is up.
        palette: red, green, blue, alpha of each index that the file gives a colour, by index.
    """

    index: NDArray[np.uint8]
    palette: dict[int, Colour] = field(default_factory=dict)


def read_vox(path: Path | str) -> VoxModel:
    """Read the one model of a .vox file; scene-graph and material chunks are passed over.

    Raises:
        DesignError: if the file is not a .vox file, is truncated, or does not hold exactly one model.
        OSError: if it cannot be read at all.
    """
    data = Path(path).read_bytes()
    if len(data) < 8 or data[:4] != MAGIC:
        raise DesignError(f"{path}: not a MagicaVoxel file, it does not start with 'VOX '")
    try:
        return _model(_chunks(data))
    except DesignError as error:
        raise DesignError(f"{path}: {error}") from None


def write_vox(path: Path | str, model: VoxModel) -> None:
    """Write one model as a .vox file; the same model gives the same bytes.

    Raises:
        DesignError: if the model is empty in some direction or larger than the format can address.
        OSError: if it cannot be written.
    """
    size = model.index.shape
    if model.index.ndim != 3 or not all(1 <= n <= LARGEST for n in size):
        raise DesignError(f"a model of {size} voxels cannot be written; each side must be 1 to {LARGEST}")
    voxels = np.argwhere(model.index > 0)
    filled = np.column_stack([voxels, model.index[tuple(voxels.T)]]).astype(np.uint8)
    palette = np.full((256, 4), 128, np.uint8)
    for index, colour in model.palette.items():
        palette[index - 1] = colour  # The file's first colour belongs to index 1.
    children = b"".join(
        [
            _chunk(b"SIZE", struct.pack("<3I", *size)),
            _chunk(b"XYZI", struct.pack("<I", len(filled)) + filled.tobytes()),
            _chunk(b"RGBA", palette.tobytes()),
        ]
    )
    Path(path).write_bytes(MAGIC + struct.pack("<I", VERSION) + _HEADER.pack(b"MAIN", 0, len(children)) + children)


def _chunk(name: bytes, content: bytes) -> bytes:
    return _HEADER.pack(name, len(content), 0) + content


def _chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    """The chunks below MAIN, in order."""
    if len(data) < 8 + _HEADER.size:
        raise DesignError("the file ends before its MAIN chunk")
    name, content, children = _HEADER.unpack_from(data, 8)
    if name != b"MAIN":
        raise DesignError(f"the first chunk is {_printable(name)}, expected MAIN")
    position, found = 8 + _HEADER.size + content, []
    end = position + children
    if end > len(data):
        raise DesignError(f"MAIN announces {children} bytes of chunks, the file holds {max(0, len(data) - position)}")
    while position < end:
        if position + _HEADER.size > end:
            raise DesignError(f"a chunk header is cut off at byte {position}")
        name, content, below = _HEADER.unpack_from(data, position)
        start = position + _HEADER.size
        position = start + content + below
        if position > end:
            raise DesignError(f"chunk {_printable(name)} announces {content + below} bytes, {end - start} are left")
        found.append((name, data[start : start + content]))
    return found


def _model(chunks: list[tuple[bytes, bytes]]) -> VoxModel:
    sizes = [content for name, content in chunks if name == b"SIZE"]
    points = [content for name, content in chunks if name == b"XYZI"]
    if len(sizes) != 1 or len(points) != 1:
        raise DesignError(f"the file holds {max(len(sizes), len(points))} models; save exactly one")
    if len(sizes[0]) != 12:
        raise DesignError(f"SIZE has {len(sizes[0])} bytes, expected 12")
    size = struct.unpack("<3I", sizes[0])
    if not all(1 <= n <= LARGEST for n in size):
        raise DesignError(f"the model is {size[0]} x {size[1]} x {size[2]} voxels; each side must be 1 to {LARGEST}")
    if len(points[0]) < 4:
        raise DesignError("XYZI does not say how many voxels it holds")
    (count,) = struct.unpack_from("<I", points[0])
    if len(points[0]) != 4 + 4 * count:
        raise DesignError(f"XYZI announces {count} voxels and holds {(len(points[0]) - 4) // 4}")
    voxels = np.frombuffer(points[0], np.uint8, offset=4).reshape(count, 4)
    outside = (voxels[:, :3] >= np.array(size)).any(axis=1)
    if outside.any():
        where = voxels[outside][0, :3].tolist()
        raise DesignError(f"voxel {where} lies outside the model of {size[0]} x {size[1]} x {size[2]}")
    index = np.zeros(size, np.uint8)
    index[tuple(voxels[:, :3].T.astype(np.intp))] = voxels[:, 3]
    return VoxModel(index, _palette(chunks))


def _palette(chunks: list[tuple[bytes, bytes]]) -> dict[int, Colour]:
    content = next((content for name, content in chunks if name == b"RGBA"), b"")
    rows = np.frombuffer(content[: len(content) // 4 * 4], np.uint8).reshape(-1, 4)
    return {k: (int(r), int(g), int(b), int(a)) for k, (r, g, b, a) in enumerate(rows[:255], start=1)}


def _printable(name: bytes) -> str:
    return repr(name.decode("ascii", "replace"))
