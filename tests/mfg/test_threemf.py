from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from mfg.catalogue import Catalogue
from mfg.parts import H2D, PAPER, PLA, TPU_90A
from mfg.print_config import interlocking, prusa_config
from mfg.solids import box
from mfg.stl import welded
from mfg.threemf import PRUSA_CONFIG, PrintObject, Volume, bambu_3mf, prusa_3mf

Writer = Callable[[list[PrintObject], str, Catalogue], bytes]
CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"


@pytest.fixture(scope="module")
def objects() -> list[PrintObject]:
    inner, outer = box((0.01, 0.01, 0.01), (0.03, 0.03, 0.03)), box((0, 0, 0), (0.04, 0.04, 0.04))
    pose = np.eye(4)
    pose[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    pose[:3, 3] = 100, 50, 7
    bone = Volume("a_bone", *welded(inner), 1, PLA)
    skin = Volume('a_skin <1> & "2"', *welded(outer - inner), 2, TPU_90A)
    return [PrintObject("a", (bone, skin), pose, 0), PrintObject("b", (bone,), np.eye(4), 1)]


def unpacked(data: bytes) -> dict[str, ElementTree.Element]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.testzip() is None
        return {name: ElementTree.fromstring(archive.read(name)) for name in archive.namelist() if name != PRUSA_CONFIG}


def test_prusa_ranges_name_every_triangle_once(objects: list[PrintObject]) -> None:
    files = unpacked(prusa_3mf(objects, "t", PAPER))
    config = files["Metadata/Slic3r_PE_model.config"]
    for thing, element in zip(objects, files["3D/3dmodel.model"].iter(f"{CORE}object"), strict=True):
        ranges = []
        for volume, wanted in zip(
            config.findall(f"object[@id='{element.get('id')}']/volume"), thing.volumes, strict=True
        ):
            first, last = int(volume.get("firstid", "")), int(volume.get("lastid", ""))
            assert last - first + 1 == len(wanted.triangles)
            ranges += range(first, last + 1)
            settings = {m.get("key"): m.get("value") for m in volume.findall("metadata")}
            assert settings["name"] == wanted.name
            assert settings["extruder"] == str(wanted.extruder)
            assert settings["fill_density"] == f"{wanted.filament.infill:.0%}"
            assert settings["fill_pattern"] == "gyroid"
            assert settings["perimeters"] == str(wanted.filament.walls)
        assert ranges == list(range(len(list(element.iter(f"{CORE}triangle")))))


def test_bambu_parts_name_their_extruder_and_infill(objects: list[PrintObject]) -> None:
    files = unpacked(bambu_3mf(objects, "t", PAPER))
    model, config = files["3D/3dmodel.model"], files["Metadata/model_settings.config"]
    assert "Metadata/project_settings.config" not in files
    meshes = {o.get("id"): o for o in model.iter(f"{CORE}object")}
    for thing, item in zip(objects, model.iter(f"{CORE}item"), strict=True):
        whole = meshes[item.get("objectid")]
        ids = [c.get("objectid") for c in whole.iter(f"{CORE}component")]
        parts = config.findall(f"object[@id='{item.get('objectid')}']/part")
        assert [part.get("id") for part in parts] == ids
        for part, wanted in zip(parts, thing.volumes, strict=True):
            settings = {m.get("key"): m.get("value") for m in part.findall("metadata")}
            assert (settings["name"], settings["extruder"]) == (wanted.name, str(wanted.extruder))
            assert settings["sparse_infill_density"] == f"{wanted.filament.infill:.0%}"
            assert len(list(meshes[part.get("id")].iter(f"{CORE}triangle"))) == len(wanted.triangles)
    plates = config.findall("plate")
    on = [[i.findall("metadata")[0].get("value") for i in plate.findall("model_instance")] for plate in plates]
    assert on == [[model.findall(f".//{CORE}item")[k].get("objectid")] for k in range(2)]


@pytest.mark.parametrize("write", [prusa_3mf, bambu_3mf])
def test_a_foreign_reader_finds_the_bodies_where_they_were_laid(write: Writer, objects: list[PrintObject]) -> None:
    scene = trimesh.load(io.BytesIO(write(objects, "t", PAPER)), file_type="3mf")
    assert_allclose(scene.bounds, [[10, 10, 7], [100, 90, 47]])


@pytest.mark.parametrize("write", [prusa_3mf, bambu_3mf])
def test_the_same_objects_give_the_same_bytes(write: Writer, objects: list[PrintObject]) -> None:
    assert write(objects, "t", PAPER) == write(objects, "t", PAPER)


@pytest.mark.parametrize(
    ("write", "config"),
    [(prusa_3mf, "Metadata/Slic3r_PE_model.config"), (bambu_3mf, "Metadata/model_settings.config")],
)
def test_two_materials_interlock_by_the_depth_of_the_catalogue_and_one_alone_does_not(
    write: Writer, config: str, objects: list[PrintObject]
) -> None:
    mixed, plain = [
        {m.get("key"): m.get("value") for m in element.findall("metadata")}
        for element in unpacked(write(objects, "t", PAPER))[config].findall("object")
    ]
    assert mixed["interlocking_beam"] == "1"
    # Beams reach half a cell beyond the boundary on average, and a cell is two beams wide.
    depth = int(mixed["interlocking_depth"]) * float(mixed["interlocking_beam_width"])
    assert depth == pytest.approx(1e3 * H2D.interlock_depth)
    assert not any(key.startswith("interlocking") for key in plain)


def test_no_beam_is_thinner_than_a_line_and_no_depth_means_no_beams() -> None:
    shallow = interlocking(replace(H2D, interlock_depth=1e-4))
    assert float(shallow["interlocking_beam_width"]) == pytest.approx(1e3 * H2D.line_width)
    assert interlocking(replace(H2D, interlock_depth=0.0)) == {"interlocking_beam": "0"}


def test_the_prusa_flavour_brings_the_printer_with_a_nozzle_for_each_filament(objects: list[PrintObject]) -> None:
    with zipfile.ZipFile(io.BytesIO(prusa_3mf(objects, "t", PAPER))) as archive:
        lines = archive.read(PRUSA_CONFIG).decode().splitlines()
    assert all(line.startswith("; ") for line in lines)
    stored = dict(line[2:].split(" = ", 1) for line in lines if " = " in line)
    assert stored == prusa_config(H2D, PLA, TPU_90A)
    assert stored["nozzle_diameter"] == "0.6,0.6"
    assert stored["bed_shape"] == "0x0,300x0,300x320,0x320"
    assert (stored["layer_height"], stored["extrusion_width"], stored["max_print_height"]) == ("0.3", "0.62", "320")
    assert stored["filament_type"] == "PLA,FLEX"
    assert stored["filament_density"] == "1.24,1.21"
