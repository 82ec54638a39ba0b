"""Pictures of a learned decoder: bodies above their reconstructions, samples of the prior, and ways between them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from decoder.comparison import compare
from decoder.evaluation import Watch, unwatched
from decoder.latent import sample_latents
from decoder.prior import arc
from decoder.reconstruction import Codec, reconstructions
from mfg.picture import contact_sheet, design_shapes
from mfg.render import render

if TYPE_CHECKING:
    from decoder.design import VoxelDesign

Image = NDArray[np.uint8]
PAIRS, PAIR_COLUMNS, PAIR_SIZE = 8, 4, (300, 220)  # size: of one body [pixel]
SAMPLES, SAMPLE_COLUMNS, SAMPLE_SIZE = 24, 6, (240, 172)
WALKS, FRAMES, FRAME_SIZE = 4, 7, (200, 150)
COLOURS = 256  # of a saved sheet


def write_sheets(
    codec: Codec, held_out: Sequence[VoxelDesign], folder: Path, seed: int, watch: Watch = unwatched
) -> tuple[Path, Path, Path]:
    """Draw the first held-out bodies with their reconstructions, samples and interpolations; nothing is picked."""
    folder.mkdir(parents=True, exist_ok=True)
    pairs, drawn, walks = (folder / f"{stem}.png" for stem in ("reconstructions", "samples", "interpolations"))
    rng = np.random.default_rng(seed)
    samples, ends = (sample_latents(n, rng) for n in (SAMPLES, 2 * WALKS))
    save_small(pairs, pairs_sheet(codec, held_out[:PAIRS], watch))
    save_small(drawn, samples_sheet(codec, samples, watch))
    save_small(walks, walks_sheet(codec, ends, watch))
    return pairs, drawn, walks


def pairs_sheet(codec: Codec, designs: Sequence[VoxelDesign], watch: Watch = unwatched) -> Image:
    """Every original above its reconstruction, seen by the same camera."""
    originals, copies = [], []
    for k, pair in enumerate(watch(reconstructions(codec, designs), len(designs), "drawing reconstructions"), start=1):
        found = compare(pair.design, pair.copy)
        bounds = _around([pair.design, pair.copy])
        originals.append((_drawn(pair.design, PAIR_SIZE, bounds), f"body {k}: {_words(pair.design)}"))
        text = f"IoU: body {found.body_iou:.2f}, bone {found.bone_iou:.2f}"
        copies.append((_drawn(pair.copy, PAIR_SIZE, bounds), text))
    rows = [
        half[start : start + PAIR_COLUMNS]
        for start in range(0, len(originals), PAIR_COLUMNS)
        for half in (originals, copies)
    ]
    blank = (np.full_like(originals[0][0], 255), "")
    cells = [cell for row in rows for cell in (*row, *[blank] * (min(PAIR_COLUMNS, len(originals)) - len(row)))]
    images, labels = zip(*cells, strict=True)
    return contact_sheet(images, labels, min(PAIR_COLUMNS, len(originals)))


def samples_sheet(codec: Codec, latents: NDArray[np.float32], watch: Watch = unwatched) -> Image:
    """What latents (n, 512) decode to."""
    designs = codec.decode(latents)
    drawn = watch(designs, len(designs), "drawing samples")
    images = [_drawn(design, SAMPLE_SIZE, design.bounds) for design in drawn]
    return contact_sheet(images, [_words(design) for design in designs], SAMPLE_COLUMNS)


def walks_sheet(codec: Codec, ends: NDArray[np.float32], watch: Watch = unwatched) -> Image:
    """A row for every two latents of `ends` (2 m, 512): bodies at equal steps from the first to the second."""
    images: list[Image] = []
    labels: list[str] = []
    ways = list(zip(ends[::2], ends[1::2], strict=True))
    for a, b in watch(ways, len(ways), "drawing interpolations"):
        designs = codec.decode(arc(a, b, FRAMES - 1))
        bounds = _around(designs)
        images += [_drawn(design, FRAME_SIZE, bounds) for design in designs]
        labels += [f"{100 * k / (FRAMES - 1):.0f} %: {_words(d)}" for k, d in enumerate(designs)]
    return contact_sheet(images, labels, FRAMES)


def save_small(path: Path, image: Image) -> None:
    """Write a picture as PNG with a palette that keeps rare colours, such as those of hinge axes."""
    from PIL import Image as Pillow

    few = Pillow.fromarray(image).quantize(COLOURS, Pillow.Quantize.MAXCOVERAGE, dither=Pillow.Dither.NONE)
    few.save(path, format="PNG", optimize=True)


def _drawn(design: VoxelDesign, size: tuple[int, int], bounds: NDArray[np.float64]) -> Image:
    return render(design_shapes(design), size, floor=float(bounds[0, 2]), bounds=bounds)


def _around(designs: Sequence[VoxelDesign]) -> NDArray[np.float64]:
    """Box around all of them, (2, 3) [m]."""
    boxes = np.stack([design.bounds for design in designs])
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def _words(design: VoxelDesign) -> str:
    count = len(design.joints)
    return f"{count} joint" if count == 1 else f"{count} joints"
