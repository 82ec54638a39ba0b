"""3MF files that a slicer can print from: rigid and soft parts as one object, each with its filament and infill.

Slicers disagree on how a part says what it is made of, so there are two flavours of the same plates. PrusaSlicer wants
one mesh per object, a table of triangle ranges, and the printer's own settings, without which it knows one nozzle only;
Bambu Studio and OrcaSlicer want one mesh per part, joined by components. Both name the interlocking per object.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from mfg.blueprint import Transform
from mfg.catalogue import Catalogue, Filament
from mfg.print_config import config_text, interlocking, prusa_config

_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_PRUSA = "http://schemas.slic3r.org/3mf/2017/06"
_BAMBU = "http://schemas.bambulab.com/package/2021"
_TYPES = """<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
 <Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
 <Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""
_RELATIONS = """<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
 <Relationship Target="/3D/3dmodel.model" Id="rel-1" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""
_EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file in the archive, so that equal content gives equal bytes
PLATE_STRIDE = 1.2  # slicers show plates side by side [plate widths]
PRUSA_CONFIG = "Metadata/Slic3r_PE.config"
_UNMOVED = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"


@dataclass(frozen=True, eq=False, slots=True)
class Volume:
    """One part of an object.

    Attributes:
        name: shown in the slicer.
        vertices: (n, 3) [mm].
        triangles: (m, 3).
        extruder: 1, 2, ...
        filament: walls and infill.
    """

    name: str
    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    extruder: int
    filament: Filament


@dataclass(frozen=True, eq=False, slots=True)
class PrintObject:
    """Parts that are printed as one piece.

    Attributes:
        name: shown in the slicer.
        volumes: its parts, all in one frame.
        pose: (4, 4) from that frame to the printer [mm].
        plate: index of the plate it stands on.
    """

    name: str
    volumes: tuple[Volume, ...]
    pose: Transform
    plate: int


def prusa_3mf(objects: Sequence[PrintObject], title: str, catalogue: Catalogue) -> bytes:
    """The PrusaSlicer flavour (2.4 or later; checked with 2.5, which passes over the interlocking that 2.9 knows)."""
    model, settings, items = [], [], []
    for number, thing in enumerate(objects, start=1):
        vertices, triangles, first, base = [], [], 0, 0
        settings.append(f' <object id="{number}" instances_count="1">')
        settings.append(_setting("object", "name", thing.name))
        settings.extend(_setting("object", key, value) for key, value in _joined(thing, catalogue).items())
        for volume in thing.volumes:
            vertices.append(volume.vertices)
            triangles.append(volume.triangles + base)
            last = first + len(volume.triangles) - 1
            settings.append(f'  <volume firstid="{first}" lastid="{last}">')
            for key, value in (
                ("name", volume.name), ("volume_type", "ModelPart"), ("matrix", _UNMOVED),
                ("extruder", str(volume.extruder)), ("perimeters", str(volume.filament.walls)),
                ("fill_density", f"{volume.filament.infill:.0%}"), ("fill_pattern", volume.filament.infill_pattern),
                ("top_solid_layers", str(volume.filament.walls)), ("bottom_solid_layers", str(volume.filament.walls)),
            ):  # fmt: skip
                settings.append(_setting("volume", key, value))
            settings.append("  </volume>")
            first, base = last + 1, base + len(volume.vertices)
        settings.append(" </object>")
        model.append(f'  <object id="{number}" type="model">')
        model.extend(_mesh(np.concatenate(vertices), np.concatenate(triangles)))
        model.append("  </object>")
        items.append(_item(number, thing.pose))
    header = [
        f'<model unit="millimeter" xml:lang="en-US" xmlns="{_CORE}" xmlns:slic3rpe="{_PRUSA}">',
        ' <metadata name="slic3rpe:Version3mf">1</metadata>',
        *_metadata(title, "bodyplan"),
    ]
    presets = config_text(prusa_config(catalogue.printer, catalogue.rigid, catalogue.soft))
    return _archive(header, model, items, {"Metadata/Slic3r_PE_model.config": _config(settings), PRUSA_CONFIG: presets})


def bambu_3mf(objects: Sequence[PrintObject], title: str, catalogue: Catalogue) -> bytes:
    """The Bambu Studio and OrcaSlicer flavour: geometry and part settings, but no presets: sparse ones crash them."""
    model, settings, items, number = [], [], [], 0
    for thing in objects:
        ids = []
        for volume in thing.volumes:
            number += 1
            ids.append(number)
            model.append(f'  <object id="{number}" type="model">')
            model.extend(_mesh(volume.vertices, volume.triangles))
            model.append("  </object>")
        number += 1
        components = [f'    <component objectid="{i}"/>' for i in ids]
        model += [
            f'  <object id="{number}" type="model">',
            "   <components>",
            *components,
            "   </components>",
            "  </object>",
        ]
        items.append(_item(number, thing.pose))
        settings += [f' <object id="{number}">', _plain("name", thing.name), _plain("extruder", "1")]
        settings += [_plain(key, value) for key, value in _joined(thing, catalogue).items()]
        for i, volume in zip(ids, thing.volumes, strict=True):
            settings.append(f'  <part id="{i}" subtype="normal_part">')
            for key, value in (
                ("name", volume.name), ("matrix", _UNMOVED), ("extruder", str(volume.extruder)),
                ("wall_loops", str(volume.filament.walls)), ("sparse_infill_density", f"{volume.filament.infill:.0%}"),
                ("sparse_infill_pattern", volume.filament.infill_pattern),
                ("top_shell_layers", str(volume.filament.walls)), ("bottom_shell_layers", str(volume.filament.walls)),
            ):  # fmt: skip
                settings.append(_plain(key, value))
            settings.append("  </part>")
        settings.append(" </object>")
    for plate in sorted({thing.plate for thing in objects}):
        settings += [" <plate>", _plain("plater_id", str(plate + 1)), _plain("locked", "false")]
        for index, thing in enumerate(objects):
            if thing.plate == plate:
                made = sum(len(o.volumes) + 1 for o in objects[: index + 1])
                settings += ["  <model_instance>", _plain("object_id", str(made)), _plain("instance_id", "0"),
                             "  </model_instance>"]  # fmt: skip
        settings.append(" </plate>")
    header = [
        f'<model unit="millimeter" xml:lang="en-US" xmlns="{_CORE}" xmlns:BambuStudio="{_BAMBU}">',
        ' <metadata name="BambuStudio:3mfVersion">1</metadata>',
        *_metadata(title, "BambuStudio-01.10.00.00"),  # anything else and the part settings are not read
    ]
    return _archive(header, model, items, {"Metadata/model_settings.config": _config(settings)})


def _joined(thing: PrintObject, catalogue: Catalogue) -> dict[str, str]:
    """Settings of an object whose parts are of different filament; none where it is all of one."""
    mixed = len({volume.extruder for volume in thing.volumes}) > 1
    return interlocking(catalogue.printer) if mixed else {}


def _mesh(vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> Iterator[str]:
    yield "   <mesh><vertices>"
    yield "\n".join('<vertex x="%.9g" y="%.9g" z="%.9g"/>' % tuple(v) for v in vertices.tolist())  # noqa: UP031
    yield "   </vertices><triangles>"
    yield "\n".join('<triangle v1="%d" v2="%d" v3="%d"/>' % tuple(t) for t in triangles.tolist())  # noqa: UP031
    yield "   </triangles></mesh>"


def _item(number: int, pose: Transform) -> str:
    # 3MF multiplies row vectors, so the matrix is written transposed: three rows of the rotation, then the translation.
    numbers = np.concatenate([pose[:3, :3].T.reshape(-1), pose[:3, 3]])
    return f'  <item objectid="{number}" transform="{" ".join(f"{v:.9g}" for v in numbers)}" printable="1"/>'


def _metadata(title: str, application: str) -> list[str]:
    return [f' <metadata name="Title">{title}</metadata>', f' <metadata name="Application">{application}</metadata>']


def _setting(kind: str, key: str, value: str) -> str:
    return f'   <metadata type="{kind}" key="{key}" value={quoteattr(value)}/>'


def _plain(key: str, value: str) -> str:
    return f'   <metadata key="{key}" value={quoteattr(value)}/>'


def _config(lines: Sequence[str]) -> str:
    return "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', "<config>", *lines, "</config>", ""])


def _archive(header: Sequence[str], objects: Sequence[str], items: Sequence[str], configs: dict[str, str]) -> bytes:
    model = "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', *header, " <resources>", *objects, " </resources>",
                       " <build>", *items, " </build>", "</model>", ""])  # fmt: skip
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        files = {"[Content_Types].xml": _TYPES, "_rels/.rels": _RELATIONS, "3D/3dmodel.model": model, **configs}
        for name, text in files.items():
            info = zipfile.ZipInfo(name, _EPOCH)
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, text.encode())
    return buffer.getvalue()
