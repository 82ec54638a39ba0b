"""The voxel design: what a latent or a sketch says about a body, before anything is asked of a printer."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from decoder.design_file import FORMAT, VERSION, read_arrays, write_arrays
from decoder.design_file import DesignError as DesignError

GRID = 64  # voxels along each side of the grid
DEFAULT_PITCH = 0.010  # edge of one voxel [m]; a body is then 0.3 to 0.64 m
DEPTH_UNIT = 16  # steps of a stored depth in one voxel
DEPTH_LIMIT = 127  # stored depths end here, about 8 voxels from the surface


class Material(IntEnum):
    """What one voxel is made of."""

    EMPTY = 0
    SOFT = 1
    RIGID = 2


@dataclass(frozen=True, eq=False, slots=True)
class Joint:
    """One hinge between two rigid segments, in the design frame (grid corner at the origin).

    Attributes:
        position: a point on the hinge axis [m], shape (3,).
        axis: unit vector of the hinge, shape (3,); the child turns about it by the right-hand rule.
        range: least and greatest angle [rad], shape (2,); the painted body stands at 0.
        parent: segment id on the root's side.
        child: segment id on the far side.
        confidence: how well the axis is known, 0 (a guess) to 1 (explicit).
    """

    position: NDArray[np.float64]
    axis: NDArray[np.float64]
    range: NDArray[np.float64]
    parent: int
    child: int
    confidence: float = 1.0

    def __post_init__(self) -> None:
        """Freeze copies of the arrays and check what does not need the grid."""
        for name, shape in (("position", (3,)), ("axis", (3,)), ("range", (2,))):
            object.__setattr__(self, name, _frozen(getattr(self, name), name, shape))
        length = float(np.linalg.norm(self.axis))
        if abs(length - 1.0) > 1e-6:
            raise DesignError(f"joint axis has length {length:.6g}; it must be a unit vector: divide it by its length")
        low, high = (float(v) for v in self.range)
        if not -np.pi <= low <= 0.0 <= high <= np.pi or low == high:
            raise DesignError(
                f"joint range is [{low:.4g}, {high:.4g}] rad; it must be low < high, hold 0 (the painted pose) "
                f"and stay within [-pi, pi]"
            )
        if self.parent == self.child:
            raise DesignError(f"joint links segment {self.parent} with itself; parent and child must differ")
        if not 0.0 <= self.confidence <= 1.0:
            raise DesignError(f"joint confidence is {self.confidence}; it must lie in [0, 1]")


@dataclass(frozen=True, eq=False)
class VoxelDesign:
    """A body on a 64^3 grid with explicit joints.

    Voxel (i, j, k) fills the cube from (i, j, k) * pitch to (i+1, j+1, k+1) * pitch in the design frame.

    Attributes:
        material: `Material` of every voxel, shape (64, 64, 64), u8.
        segment: rigid segment id (1, 2, ...) of every rigid voxel, shape (64, 64, 64), i16. A soft voxel may carry
            the id of the segment it belongs to, or 0 for "the nearest bone"; an empty voxel carries 0.
        pitch: edge of a voxel [m].
        joints: the hinges; together they never close a loop.
        depth: where known, how deep every voxel's centre lies in the bones [0] and in the body, bones and soft tissue
            together [1], in 1/16 voxel, negative outside, ending at +-127; shape (2, 64, 64, 64), i8. Bone depth is
            above 0 exactly where material is rigid, body depth exactly where it is not empty. See `quantised`.

    Raises:
        DesignError: naming the invariant that is broken, the value, the bound and the remedy.
    """

    material: NDArray[np.uint8]
    segment: NDArray[np.int16]
    pitch: float = DEFAULT_PITCH
    joints: tuple[Joint, ...] = field(default=())
    depth: NDArray[np.int8] | None = None

    def __post_init__(self) -> None:
        """Freeze copies of the arrays and check every invariant."""
        object.__setattr__(self, "material", _grid(self.material, "material", np.uint8))
        object.__setattr__(self, "segment", _grid(self.segment, "segment", np.int16))
        object.__setattr__(self, "joints", tuple(self.joints))
        object.__setattr__(self, "pitch", float(self.pitch))
        if not 1e-4 <= self.pitch <= 0.1:
            raise DesignError(f"pitch is {self.pitch:g} m; it must lie in [0.0001, 0.1] m")
        if int(self.material.max()) > Material.RIGID:
            raise DesignError(f"material holds {int(self.material.max())}; known are 0 empty, 1 soft, 2 rigid")
        rigid = self.material == Material.RIGID
        if not rigid.any():
            raise DesignError("the grid holds no rigid voxel; paint at least one bone")
        if int(self.segment.min()) < 0:
            raise DesignError(f"segment holds {int(self.segment.min())}; ids are 1, 2, ... and 0 for none")
        if (self.segment[rigid] == 0).any():
            raise DesignError("a rigid voxel has segment 0; every rigid voxel needs a segment id of 1 or more")
        if self.segment[self.material == Material.EMPTY].any():
            raise DesignError("an empty voxel has a segment id; empty voxels carry segment 0")
        _check_margin(self.material)
        if self.depth is not None:
            object.__setattr__(self, "depth", _grid(self.depth, "depth", np.int8, (2, GRID, GRID, GRID)))
            _check_depth(self.depth, self.material)
        known = set(self.segments)
        claimed = set(np.unique(self.segment[self.material == Material.SOFT]).tolist()) - {0}
        if not claimed <= known:
            raise DesignError(f"soft voxels belong to segments {sorted(claimed - known)}, which have no rigid voxel")
        _check_joints(self.joints, known, self.bounds)

    @cached_property
    def segments(self) -> tuple[int, ...]:
        """Ids of the rigid segments, ascending."""
        return tuple(int(s) for s in np.unique(self.segment[self.material == Material.RIGID]))

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """Corners of the box around every non-empty voxel in the design frame [m], shape (2, 3)."""
        filled = np.argwhere(self.material > 0)
        return np.stack([filled.min(0), filled.max(0) + 1]) * self.pitch

    @cached_property
    def key(self) -> str:
        """Content hash (16 hex digits of SHA-256): the id of this design everywhere."""
        digest = hashlib.sha256(f"{FORMAT}/{VERSION}/{self.pitch!r}/{len(self.joints)}".encode())
        digest.update(self.material.tobytes())
        digest.update(self.segment.astype("<i2").tobytes())
        for array in self._joint_arrays().values():
            digest.update(array.tobytes())
        if self.depth is not None:
            digest.update(self.depth.tobytes())
        return digest.hexdigest()[:16]

    def save(self, path: Path | str | BinaryIO) -> None:
        """Write a versioned .npz without pickle, to a path or an open binary file."""
        arrays: dict[str, NDArray[Any]] = {
            "material": self.material,
            "segment": self.segment,
            "pitch": np.array(self.pitch),
            **self._joint_arrays(),
            **({} if self.depth is None else {"depth": self.depth}),
        }
        write_arrays(path, arrays)

    @classmethod
    def load(cls, path: Path | str) -> VoxelDesign:
        """Read a design written by `save`.

        Raises:
            DesignError: if the file is truncated, foreign, pickled, of another version or breaks an invariant.
            OSError: if it cannot be read at all.
        """
        stored = read_arrays(path)
        try:
            return cls(
                stored["material"], stored["segment"], _scalar(stored["pitch"]), tuple(_joints(stored)),
                stored.get("depth"),
            )  # fmt: skip
        except DesignError as error:
            raise DesignError(f"{path}: {error}") from None

    def _joint_arrays(self) -> dict[str, NDArray[Any]]:
        n = len(self.joints)
        return {
            "position": np.array([j.position for j in self.joints], "<f8").reshape(n, 3),
            "axis": np.array([j.axis for j in self.joints], "<f8").reshape(n, 3),
            "range": np.array([j.range for j in self.joints], "<f8").reshape(n, 2),
            "link": np.array([(j.parent, j.child) for j in self.joints], "<i4").reshape(n, 2),
            "confidence": np.array([j.confidence for j in self.joints], "<f8").reshape(n),
        }


def quantised(bone: NDArray[np.floating], body: NDArray[np.floating]) -> NDArray[np.int8]:
    """Depths [voxels] in bones and in the body, (64, 64, 64) each, as `VoxelDesign.depth`, (2, 64, 64, 64).

    Rounded to the nearest 1/16, but never to 0: a depth above 0 stays above, and all others (0 too) become negative.

    Raises:
        DesignError: if a depth is not a number.
    """
    depth = np.stack([bone, body]).astype(np.float64) * DEPTH_UNIT
    if np.isnan(depth).any():
        raise DesignError(f"depth is not a number at {np.isnan(depth).sum()} voxels; it must be known everywhere")
    steps = np.where(depth > 0, np.maximum(np.rint(depth), 1), np.minimum(np.rint(depth), -1))
    return steps.clip(-DEPTH_LIMIT, DEPTH_LIMIT).astype(np.int8)


def _frozen(value: ArrayLike, name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError):
        raise DesignError(f"joint {name} is not a list of numbers") from None
    if array.shape != shape:
        raise DesignError(f"joint {name} has shape {array.shape}, expected {shape}")
    if not np.isfinite(array).all():
        raise DesignError(f"joint {name} is {array.tolist()}; every number must be finite")
    array.setflags(write=False)
    return array


def _grid(value: ArrayLike, name: str, dtype: type, shape: tuple[int, ...] = (GRID, GRID, GRID)) -> NDArray[Any]:
    array = np.asarray(value)
    if array.shape != shape:
        raise DesignError(f"{name} has shape {array.shape}, expected {shape}")
    if array.dtype.kind not in "iu":
        raise DesignError(f"{name} holds {array.dtype}; it must hold whole numbers")
    info = np.iinfo(dtype)
    if int(array.min()) < info.min or int(array.max()) > info.max:
        raise DesignError(f"{name} holds values outside [{info.min}, {info.max}]")
    array = np.ascontiguousarray(array).astype(dtype)
    array.setflags(write=False)
    return array


def _scalar(array: NDArray[Any]) -> float:
    if array.size != 1 or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise DesignError(f"pitch is {array.tolist()!r}; it must be one finite number [m]")
    return float(array.reshape(()))


def _check_margin(material: NDArray[np.uint8]) -> None:
    for axis, letter in enumerate("xyz"):
        for index in (0, GRID - 1):
            if material.take(index, axis).any():
                raise DesignError(
                    f"the body touches the border of the grid ({letter} = {index}); "
                    f"keep it within voxels 1 to {GRID - 2}: move it or make it smaller"
                )


def _check_depth(depth: NDArray[np.int8], material: NDArray[np.uint8]) -> None:
    bone = int(((depth[0] > 0) != (material == Material.RIGID)).sum())
    body = int(((depth[1] > 0) != (material != Material.EMPTY)).sum())
    if bone or body:
        raise DesignError(
            f"depth and material disagree at {bone} voxels of bone and {body} of body; bone depth must be above 0 "
            f"exactly at rigid voxels, body depth exactly at voxels that are not empty"
        )


def _check_joints(joints: tuple[Joint, ...], known: set[int], bounds: NDArray[np.float64]) -> None:
    group = {s: s for s in known}

    def find(s: int) -> int:
        while group[s] != s:
            s = group[s]
        return s

    for index, joint in enumerate(joints):
        for segment in (joint.parent, joint.child):
            if segment not in known:
                raise DesignError(f"joint {index} joins segment {segment}, but the design has segments {sorted(known)}")
        if (joint.position < bounds[0] - 1e-9).any() or (joint.position > bounds[1] + 1e-9).any():
            raise DesignError(
                f"joint {index} at {joint.position.round(4).tolist()} m lies outside the body, which spans "
                f"{bounds[0].round(4).tolist()} to {bounds[1].round(4).tolist()} m"
            )
        a, b = find(joint.parent), find(joint.child)
        if a == b:
            raise DesignError(
                f"joint {index} ({joint.parent}-{joint.child}) closes a loop; remove one joint of the cycle"
            )
        group[a] = b


def _joints(stored: dict[str, NDArray[Any]]) -> Iterator[Joint]:
    arrays = {name: stored[name] for name in ("position", "axis", "range", "link", "confidence")}
    for name, array in arrays.items():
        wanted = "iu" if name == "link" else "fiu"
        if array.dtype.kind not in wanted:
            raise DesignError(f"joint {name} holds {array.dtype}; it must hold numbers")
    n = arrays["position"].shape[0] if arrays["position"].ndim else -1
    for name, width in (("position", (3,)), ("axis", (3,)), ("range", (2,)), ("link", (2,)), ("confidence", ())):
        if arrays[name].shape != (n, *width):
            raise DesignError(f"joint {name} has shape {arrays[name].shape}, expected {(n, *width)}")
    for i in range(n):
        parent, child = (int(v) for v in arrays["link"][i])
        yield Joint(arrays["position"][i], arrays["axis"][i], arrays["range"][i], parent, child,
                    float(arrays["confidence"][i]))  # fmt: skip
