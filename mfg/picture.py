"""Pictures of designs and blueprints, in the colours of the paper's figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from decoder.design import Joint, Material, VoxelDesign
from mfg.blueprint import Blueprint
from mfg.fields import Field
from mfg.mounts import housing, motor_pose, mount_of
from mfg.render import render
from mfg.shape import Colour, Shape
from mfg.skins import soft_owner
from mfg.solids import Solid, ball_chain, box, cylinder, from_field, union
from mfg.voxel_fields import bone_field, whole_field

if TYPE_CHECKING:
    from PIL.Image import Image as Canvas

Image = NDArray[np.uint8]

SKIN: Colour = (0.36, 0.58, 0.80)
MOTOR: Colour = (0.22, 0.62, 0.32)
BATTERY: Colour = (0.16, 0.30, 0.78)
CONTROLLER: Colour = (0.80, 0.18, 0.16)
WIRE: Colour = (0.95, 0.76, 0.10)
AXIS: Colour = (0.72, 0.10, 0.16)
# Neighbouring bones differ in tint, so that segments can be told apart.
BONES: tuple[Colour, ...] = (
    (0.86, 0.87, 0.89), (0.93, 0.86, 0.74), (0.80, 0.88, 0.80), (0.91, 0.80, 0.80), (0.78, 0.86, 0.92),
    (0.90, 0.88, 0.70), (0.86, 0.80, 0.92), (0.76, 0.90, 0.88),
)  # fmt: skip
# Segments of a bare design, where nothing else is coloured: far from each other, from the skin and from the axes.
SEGMENTS: tuple[Colour, ...] = (
    (0.91, 0.89, 0.82), (0.90, 0.66, 0.22), (0.42, 0.68, 0.36), (0.62, 0.46, 0.78), (0.16, 0.62, 0.60),
    (0.88, 0.82, 0.36), (0.90, 0.58, 0.72), (0.55, 0.42, 0.30),
)  # fmt: skip
SKIN_ALPHA, THIN_ALPHA = 0.28, 0.13  # of the skin of a blueprint, and of a bare design, whose bones are to be seen
SMOOTHING = 0.8  # of the surfaces of a bare design, as in the solvers [voxels]
SURFACE = 1.5e-3  # a triangle of a skin shallower than this belongs to its outer surface [m]
AXIS_RADIUS, AXIS_LENGTH = 0.005, 0.15  # of the rod that shows a hinge [m]
CAP_RADIUS, CAP_LENGTH = 0.011, 0.008  # of the discs at its ends [m]
AXIS_GHOST = 0.45  # how much of an axis shows through the bones before it
AXIS_CORE, AXIS_OUT = 0.045, 0.025  # a rod passes what lies so near to its axis by so much [m]
AXIS_REACH = (0.055, 0.16)  # least and most from its middle to an end [m]
LABEL_HEIGHT = 34  # of one line of text under a picture [pixels]


def picture_of_design(design: VoxelDesign, size: tuple[int, int] = (640, 480)) -> Image:
    """Draw a design before any hardware: bones coloured by segment, skin a translucent shell, hinge axes as rods.

    An axis sticks out of the bones that it joins, and where they hide it, it shows through them faintly.
    """
    return render(design_shapes(design), size, floor=True)


def design_shapes(design: VoxelDesign) -> list[Shape]:
    """The shapes of `picture_of_design`, design frame."""
    shapes = []
    owner = soft_owner(design)
    for index, segment in enumerate(design.segments):
        shapes.append(_shape(from_field(bone_field(design, segment, SMOOTHING)), SEGMENTS[index % len(SEGMENTS)]))
        soft = owner == segment
        if soft.any():
            whole = from_field(whole_field(design, segment, soft, SMOOTHING))
            shapes.append(_shape(whole, SKIN, THIN_ALPHA))
    shapes += [axis_rod(joint.position, joint.axis, _through(design, joint)) for joint in design.joints]
    return shapes


def picture_of_blueprint(
    blueprint: Blueprint,
    size: tuple[int, int] = (640, 480),
    explode: float = 0.0,
    *,
    azimuth: float = -0.95,
    elevation: float = 0.40,
) -> Image:
    """Draw a blueprint as in the paper's Fig. 2.

    Args:
        blueprint: its parts if it is built, else its fields.
        size: of the picture [pixels].
        explode: how far bodies move apart, as a share of their distance from the root.
        azimuth: of the camera about z [rad].
        elevation: of the camera above the horizon [rad].
    """
    return render(blueprint_shapes(blueprint, explode), size, azimuth, elevation, floor=explode == 0.0)


def blueprint_shapes(blueprint: Blueprint, explode: float = 0.0) -> list[Shape]:
    """The shapes of `picture_of_blueprint`, design frame; a motor moves with the body that holds it."""
    shift = _shifts(blueprint, explode)
    shapes = [*_printed(blueprint, shift)]
    if blueprint.seats:
        looks = blueprint.catalogue.motor.looks
        plain = _shape(housing(mount_of(blueprint.catalogue.motor)), MOTOR)
        motor = plain if looks is None else Shape(looks.vertices, looks.triangles, MOTOR)
        for seat in blueprint.seats:
            shapes.append(_pushed(motor.moved(seat.T_design_motor), shift[seat.holder]))
    for place in blueprint.boxes:
        half = np.array(place.size) / 2
        colour = BATTERY if place.kind == "battery" else CONTROLLER
        shapes.append(_pushed(_shape(box(-half, half), colour).moved(place.T_design_box), shift[place.body]))
    if explode == 0.0:
        shapes += [_shape(ball_chain(wire.path, wire.radius), WIRE) for wire in blueprint.wires]
    if not blueprint.seats:
        shapes += [axis_rod(hinge.position, hinge.axis) for hinge in blueprint.hinges]
    return shapes


def axis_rod(
    position: NDArray[np.float64],
    axis: NDArray[np.float64],
    ends: tuple[float, float] = (-AXIS_LENGTH / 2, AXIS_LENGTH / 2),
) -> Shape:
    """A rod along a hinge axis with a disc at either end, from its middle [m]; it shows through what is before it."""
    low, high = ends
    rod = union([
        cylinder(AXIS_RADIUS, low, high, 16),
        cylinder(CAP_RADIUS, low, low + CAP_LENGTH, 24),
        cylinder(CAP_RADIUS, high - CAP_LENGTH, high, 24),
    ])  # fmt: skip
    return replace(_shape(rod, AXIS), ghost=AXIS_GHOST).moved(motor_pose(position, axis, 0.0))


def _through(design: VoxelDesign, joint: Joint) -> tuple[float, float]:
    """Ends of a rod through a joint that sticks out of the two bones, from its middle [m]."""
    bones = (design.material == Material.RIGID) & np.isin(design.segment, (joint.parent, joint.child))
    offset = (np.argwhere(bones) + 0.5) * design.pitch - joint.position
    along = offset @ joint.axis
    near = along[np.linalg.norm(offset - along[:, None] * joint.axis, axis=1) < AXIS_CORE]
    least, most = AXIS_REACH
    low, high = (near.min(), near.max()) if len(near) else (0.0, 0.0)
    return -float(np.clip(AXIS_OUT - low, least, most)), float(np.clip(high + AXIS_OUT, least, most))


def contact_sheet(images: Sequence[Image], labels: Sequence[str], columns: int = 4) -> Image:
    """Lay pictures of one size out in rows, each with a line of text below it.

    Raises:
        ValueError: if there is no picture, or the numbers of pictures and labels differ.
    """
    from PIL import Image as Pillow
    from PIL import ImageDraw, ImageFont

    if not images or len(images) != len(labels):
        raise ValueError(f"{len(images)} pictures and {len(labels)} labels: give one label for each of one or more")
    height, width = images[0].shape[:2]
    rows = -(-len(images) // columns)
    sheet: Canvas = Pillow.new("RGB", (columns * width, rows * (height + LABEL_HEIGHT)), "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=max(12.0, LABEL_HEIGHT * 0.45))
    for k, (image, label) in enumerate(zip(images, labels, strict=True)):
        x, y = (k % columns) * width, (k // columns) * (height + LABEL_HEIGHT)
        sheet.paste(Pillow.fromarray(image), (x, y))
        draw.text((x + width / 2, y + height + LABEL_HEIGHT / 2), label, fill="#333333", font=font, anchor="mm")
    return np.asarray(sheet)


def _printed(blueprint: Blueprint, shift: list[NDArray[np.float64]]) -> list[Shape]:
    shapes = []
    if blueprint.parts:
        for part in blueprint.parts:
            if part.material == "rigid":
                shape = _shape(part.solid, BONES[part.body % len(BONES)])
            else:
                shape = _outside(part.solid, blueprint.bodies[part.body].skin)
            shapes.append(_pushed(shape, shift[part.body]))
        return shapes
    for index, body in enumerate(blueprint.bodies):
        shapes.append(_pushed(_shape(from_field(body.bone), BONES[index % len(BONES)]), shift[index]))
        if body.skin is not None:
            shapes.append(_pushed(_shape(from_field(body.skin), SKIN, SKIN_ALPHA), shift[index]))
    return shapes


def _outside(solid: Solid, skin: Field | None) -> Shape:
    """The outer surface of a skin; its inner one coincides with the bone and would flicker through it."""
    centres = solid.vertices[solid.triangles].mean(axis=1)
    shown = np.ones(len(centres), bool) if skin is None else skin.sample(centres) < SURFACE
    return Shape(solid.vertices, solid.triangles[shown], SKIN, SKIN_ALPHA)


def _shifts(blueprint: Blueprint, explode: float) -> list[NDArray[np.float64]]:
    centres = [body.bone.centroid() for body in blueprint.bodies]
    return [explode * (centre - centres[0]) for centre in centres]


def _shape(solid: Solid, colour: Colour, alpha: float = 1.0) -> Shape:
    return Shape(solid.vertices, solid.triangles, colour, alpha)


def _pushed(shape: Shape, shift: NDArray[np.float64]) -> Shape:
    return replace(shape, vertices=shape.vertices + shift) if shift.any() else shape
