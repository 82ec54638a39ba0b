"""STEP files (ISO 10303-21, AP214) of printed parts for CAD programs: one solid of flat triangular faces.

A part is a MANIFOLD_SOLID_BREP whose faces share their edges, so a CAD program reads a closed solid with its exact
volume. It stays a mesh in nature: holes are polygons, and no feature has a history.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from mfg.stl import torn_edges

DECIMALS = 6  # of a coordinate in millimetres: finer than the lattice of the files, so no two corners meet
FLAT = 2e-5  # least height of a triangle: the edges of a flatter one cannot be told apart [mm]
_PASSES = 8  # of flips; a flip can leave another flat triangle
_EPOCH = "1980-01-01T00:00:00"  # of every file, so that equal content gives equal bytes
_HEADER = """ISO-10303-21;
HEADER;
FILE_DESCRIPTION(('printed part'),'2;1');
FILE_NAME({name},'{epoch}',(''),(''),'bodyplan','bodyplan','');
FILE_SCHEMA(('AUTOMOTIVE_DESIGN {{ 1 0 10303 214 1 1 1 1 }}'));
ENDSEC;
DATA;
"""
# Numbers 1 to 19 belong to the product and its units, 20 is the solid, 21 its shell.
_PRODUCT = """#1=APPLICATION_CONTEXT('automotive design');
#2=APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,#1);
#3=PRODUCT_CONTEXT('',#1,'mechanical');
#4=PRODUCT({name},{name},'',(#3));
#5=PRODUCT_RELATED_PRODUCT_CATEGORY('part',$,(#4));
#6=PRODUCT_DEFINITION_FORMATION('','',#4);
#7=PRODUCT_DEFINITION_CONTEXT('part definition',#1,'design');
#8=PRODUCT_DEFINITION('design','',#6,#7);
#9=PRODUCT_DEFINITION_SHAPE('','',#8);
#10=SHAPE_DEFINITION_REPRESENTATION(#9,#11);
#11=ADVANCED_BREP_SHAPE_REPRESENTATION({name},(#20,#16),#12);
#12=(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#15))GLOBAL_UNIT_ASSIGNED_CONTEXT((#13,#14,#19))REPRESENTATION_CONTEXT('',''));
#13=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));
#14=(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.));
#15=UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-06),#13,'distance_accuracy_value','');
#16=AXIS2_PLACEMENT_3D('',#17,#18,$);
#17=CARTESIAN_POINT('',(0.,0.,0.));
#18=DIRECTION('',(0.,0.,1.));
#19=(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT());
#20=MANIFOLD_SOLID_BREP({name},#21);
"""
_FIRST = 22


def step_bytes(vertices: NDArray[np.float64], triangles: NDArray[np.int64], name: str) -> bytes:
    """The STEP file of a closed mesh; same input, same bytes.

    Args:
        vertices: (n, 3) [mm], on the lattice of `mfg.stl.welded`.
        triangles: (m, 3), counter-clockwise seen from outside.
        name: of the product.

    Raises:
        ValueError: if the mesh is not closed.
    """
    if len(triangles) == 0 or len(torn_edges(triangles)):
        raise ValueError(f"{name}: a STEP solid needs a closed mesh")
    points = np.round(vertices, DECIMALS) + 0.0  # no negative zeros
    triangles = without_flat(points, triangles)
    n, m = len(points), len(triangles)
    ends, sides, along = _edges(triangles)
    e = len(ends)
    point, vertex = _FIRST, _FIRST + n
    edge = vertex + n  # direction, vector, line and curve of one edge after the other
    face = edge + 4 * e  # ten entities of one face after the other
    quoted = "'" + name.replace("'", "''") + "'"
    lines: list[Iterable[str]] = [
        (f"#{point + k}=CARTESIAN_POINT('',({x:.6f},{y:.6f},{z:.6f}));" for k, (x, y, z) in enumerate(points.tolist())),
        (f"#{vertex + k}=VERTEX_POINT('',#{point + k});" for k in range(n)),
        _edge_lines(points, ends, edge, point, vertex),
        _face_lines(points, triangles, sides, along, face, edge, point),
    ]
    shell = ",".join(f"#{face + 10 * k + 9}" for k in range(m))
    body = "\n".join("\n".join(part) for part in lines)
    text = (
        _HEADER.format(name=quoted, epoch=_EPOCH)
        + _PRODUCT.format(name=quoted)
        + f"#21=CLOSED_SHELL('',({shell}));\n{body}\nENDSEC;\nEND-ISO-10303-21;\n"
    )
    return text.encode("ascii", "replace")


def without_flat(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """The same closed mesh with the longest edge of every flat triangle turned, where that gives two sound ones.

    A flat triangle is no face: its plane is undefined. Turning its longest edge within the quadrilateral that it forms
    with its neighbour moves the surface by less than the triangle's height.
    """
    triangles = triangles.copy()
    for _ in range(_PASSES):
        flat = np.flatnonzero(_heights(points, triangles) < FLAT)
        if not len(flat):
            break
        of_edge = {(int(t[k]), int(t[k - 2])): i for i, t in enumerate(triangles) for k in range(3)}
        touched: set[int] = set()
        for index in flat.tolist():
            corners = triangles[index]
            lengths = np.linalg.norm(points[corners] - points[np.roll(corners, -1)], axis=1)
            a, b, c = np.roll(corners, -int(lengths.argmax())).tolist()  # a-b is the longest edge, c lies on it
            other = of_edge[b, a]
            (d,) = set(triangles[other].tolist()) - {a, b}
            if {index, other} & touched or (c, d) in of_edge or (d, c) in of_edge:
                continue
            triangles[index], triangles[other] = (a, d, c), (d, b, c)
            touched |= {index, other}
        if not touched:
            break
    return triangles


def _heights(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> NDArray[np.float64]:
    """Least height of every triangle."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    twice = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([np.linalg.norm(u - v, axis=1) for u, v in ((a, b), (b, c), (c, a))], axis=0)
    return np.asarray(twice / longest)


def _edges(triangles: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Edges (e, 2) lower corner first; the edge of each side (m, 3); whether the side runs along its edge (m, 3)."""
    start, end = triangles, np.roll(triangles, -1, axis=1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    count = int(triangles.max()) + 1
    found, index = np.unique((low * count + high).reshape(-1), return_inverse=True)
    return np.stack([found // count, found % count], axis=1), index.reshape(-1, 3), start < end


def _edge_lines(
    points: NDArray[np.float64], ends: NDArray[np.int64], first: int, point: int, vertex: int
) -> Iterator[str]:
    direction = points[ends[:, 1]] - points[ends[:, 0]]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for k, ((x, y, z), (a, b)) in enumerate(zip(direction.tolist(), ends.tolist(), strict=True)):
        i = first + 4 * k
        yield (
            f"#{i}=DIRECTION('',({x:.12f},{y:.12f},{z:.12f}));\n#{i + 1}=VECTOR('',#{i},1.);\n"
            f"#{i + 2}=LINE('',#{point + a},#{i + 1});\n"
            f"#{i + 3}=EDGE_CURVE('',#{vertex + a},#{vertex + b},#{i + 2},.T.);"
        )


def _face_lines(
    points: NDArray[np.float64], triangles: NDArray[np.int64], sides: NDArray[np.int64], along: NDArray[np.bool_],
    first: int, edge: int, point: int,
) -> Iterator[str]:  # fmt: skip
    a, b, c = points[triangles].transpose(1, 0, 2)
    normal, tangent = np.cross(b - a, c - a), b - a
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    corner = triangles[:, 0].tolist()
    for k, (n, t, side, sense) in enumerate(
        zip(normal.tolist(), tangent.tolist(), sides.tolist(), along.tolist(), strict=True)
    ):
        i = first + 10 * k
        yield (
            f"#{i}=DIRECTION('',({n[0]:.12f},{n[1]:.12f},{n[2]:.12f}));\n"
            f"#{i + 1}=DIRECTION('',({t[0]:.12f},{t[1]:.12f},{t[2]:.12f}));\n"
            f"#{i + 2}=AXIS2_PLACEMENT_3D('',#{point + corner[k]},#{i},#{i + 1});\n#{i + 3}=PLANE('',#{i + 2});\n"
            + "".join(
                f"#{i + 4 + j}=ORIENTED_EDGE('',*,*,#{edge + 4 * side[j] + 3},{'.T.' if sense[j] else '.F.'});\n"
                for j in range(3)
            )
            + f"#{i + 7}=EDGE_LOOP('',(#{i + 4},#{i + 5},#{i + 6}));\n#{i + 8}=FACE_OUTER_BOUND('',#{i + 7},.T.);\n"
            f"#{i + 9}=ADVANCED_FACE('',(#{i + 8}),#{i + 3},.T.);"
        )
