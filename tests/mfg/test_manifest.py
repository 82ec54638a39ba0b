from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfg.blueprint import Crossing, WireRun
from mfg.description import describe
from mfg.export import blueprint_files
from mfg.manifest import (
    NAME,
    ManifestError,
    changed_files,
    manifest,
    manifest_bytes,
    read_description,
    read_manifest,
)
from mfg.pipeline import Outcome
from mfg.plate import Lay
from mfg.splitting import pieces


@pytest.fixture(scope="module")
def content(built: Outcome) -> bytes:
    return blueprint_files(built.blueprint)[NAME]


@pytest.fixture
def path(content: bytes, tmp_path: Path) -> Path:
    (tmp_path / NAME).write_bytes(content)
    return tmp_path / NAME


def test_the_robot_is_read_back_to_the_last_bit(path: Path, built: Outcome) -> None:
    ours, theirs = describe(built.blueprint), read_description(path.parent)
    assert theirs.skin == ours.skin
    assert [link.skin_thickness for link in theirs.links] == [link.skin_thickness for link in ours.links]
    assert (theirs.name, theirs.source, theirs.imu_link) == (ours.name, ours.source, ours.imu_link)
    assert theirs.standing_height == ours.standing_height
    assert np.array_equal(theirs.T_link_imu, ours.T_link_imu)
    for a, b in zip(ours.links, theirs.links, strict=True):
        assert (a.name, a.parent, a.mass) == (b.name, b.parent, b.mass)
        for name in ("T", "com", "inertia", "hull"):
            assert np.array_equal(getattr(a, name), getattr(b, name))
    for a, b in zip(ours.joints, theirs.joints, strict=True):
        assert (a.name, a.link, a.motor, a.can_id, a.sign) == (b.name, b.link, b.motor, b.can_id, b.sign)
        assert np.array_equal(a.axis, b.axis)
        assert np.array_equal(a.range, b.range)


def test_the_manifest_says_what_was_built(content: bytes, built: Outcome) -> None:
    document, blueprint = json.loads(content), built.blueprint
    assert document["rules"] == blueprint.rules == "search"
    assert document["design"] == blueprint.design.key
    assert document["scores"]["total"] == pytest.approx(blueprint.scores.total)
    assert [part["name"] for part in document["parts"]] == [part.name for part in blueprint.parts]
    assert [joint["can_id"] for joint in document["joints"]] == [1, 2]
    for part, stored in zip(blueprint.parts, document["parts"], strict=True):
        assert stored["volume"] == part.solid.volume
        assert_allclose(stored["bounds_mm"], part.solid.bounds * 1e3, atol=1e-4)
    assert document["robot"]["mass"] == pytest.approx(sum(body["mass"] for body in document["bodies"]))


def test_cables_come_back_with_their_slack_and_every_joint_that_they_cross(built: Outcome, tmp_path: Path) -> None:
    blueprint = built.blueprint
    rng = np.random.default_rng(3)

    def crossing(hinge: int) -> Crossing:
        a, b, span, slack = (float(v) for v in rng.uniform(0.01, 0.1, 4))
        return Crossing(hinge, rng.uniform(0, 0.6, 3), span, (a, b), slack)

    first, second = blueprint.wires
    lays = [Lay(0, np.eye(4), np.ones(3))] * len(pieces(blueprint))
    wires = replace(first, crossings=(crossing(1), crossing(0))), replace(second, crossings=())
    document = manifest(replace(blueprint, wires=wires), describe(blueprint), lays, {})
    (tmp_path / NAME).write_bytes(manifest_bytes(document))
    stored = read_manifest(tmp_path)["wires"]
    seat = {hinge.name: k for k, hinge in enumerate(blueprint.hinges)}
    for wire, row in zip(wires, stored, strict=True):
        crossings = tuple(
            Crossing(seat[c["joint"]], np.array(c["position"]), c["span"], tuple(c["needed"]), c["slack"])
            for c in row["crossings"]
        )
        again = WireRun(row["name"], seat[row["joint"]], np.array(row["path"]), row["radius"], crossings)
        assert (again.name, again.seat, again.radius, again.slack) == (wire.name, wire.seat, wire.radius, wire.slack)
        assert (row["slack"], row["cable_length"]) == (wire.slack, wire.cable_length)
        assert_allclose(again.path, wire.path, atol=5.1e-7)
        for a, b in zip(again.crossings, wire.crossings, strict=True):
            assert (a.hinge, a.span, a.needed, a.slack) == (b.hinge, b.span, b.needed, b.slack)
            assert_allclose(a.position, b.position, atol=5.1e-7)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda d: d.update(format="other"), "not a blueprint manifest"),
        (lambda d: d.update(version=99), "this program reads version 1"),
        (lambda d: d.pop("robot"), "incomplete or malformed"),
        (lambda d: d["robot"]["links"][1].update(parent=5), "earlier links"),
        (lambda d: d["robot"]["links"][0].update(com=[0, 1]), "expected"),
        (lambda d: d["robot"]["joints"][0]["motor"].pop("mass"), "incomplete or malformed"),
        (lambda d: d["robot"].update(links=[]), "earlier links"),
        (lambda d: d["robot"].update(imu_link=7), "does not exist"),
        (lambda d: d["robot"]["joints"][0].update(sign=0), "sign 0"),
        (lambda d: d["robot"]["joints"][0].update(can_id=16), "CAN id 16"),
    ],
)
def test_a_spoiled_manifest_is_refused_in_one_line(path: Path, edit, message: str) -> None:
    document = json.loads(path.read_bytes())
    edit(document)
    path.write_text(json.dumps(document))
    with pytest.raises(ManifestError, match=message) as caught:
        read_description(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_older_manifest_still_tells_which_way_motors_turn(path: Path) -> None:
    document = json.loads(path.read_bytes())
    for joint, old in zip(document["joints"], document["robot"]["joints"], strict=True):
        del old["sign"], old["can_id"]
        joint["sign"] = -1
    path.write_text(json.dumps(document))
    assert [(joint.can_id, joint.sign) for joint in read_description(path).joints] == [(1, -1), (2, -1)]


@pytest.mark.parametrize("data", [b"", b"{", b"[]", b"\xff\xfe", b'{"format": NaN}'])
def test_what_is_not_a_manifest_is_refused(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    with pytest.raises(ManifestError, match=str(path)):
        read_manifest(path)


def test_a_missing_manifest_is_an_operating_system_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_manifest(tmp_path / NAME)


def test_missing_files_count_as_changed(path: Path) -> None:
    assert len(changed_files(path.parent)) == len(json.loads(path.read_bytes())["files"])
