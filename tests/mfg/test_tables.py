from __future__ import annotations

import csv
import io
from dataclasses import replace

import pytest

from mfg.addresses import MAX_BUS, can_address, turn_sign
from mfg.masses import body_masses
from mfg.pipeline import Outcome
from mfg.tables import bill_of_materials, wiring_table


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_what_is_bought_and_printed_weighs_as_much_as_the_robot(built: Outcome) -> None:
    listed = sum(float(row["mass_g"] or 0) for row in rows(bill_of_materials(built.blueprint)))
    assert listed == pytest.approx(1e3 * sum(m.mass for m in body_masses(built.blueprint)), abs=1.0)


def test_every_motor_brings_its_screws(built: Outcome) -> None:
    motor, count = built.blueprint.catalogue.motor, len(built.blueprint.seats)
    table = {row["item"]: row for row in rows(bill_of_materials(built.blueprint))}
    assert table[motor.name]["quantity"] == str(count)
    assert table[motor.body_screws.screw]["quantity"] == str(count * motor.body_screws.count)
    assert table[motor.output_screws.screw]["quantity"] == str(count * motor.output_screws.count)
    assert table[motor.body_screws.screw]["note"] == f"{motor.body_screws.count} per joint, motor to holder"


def test_every_joint_has_an_encoder_that_weighs_nothing_in_the_model(built: Outcome) -> None:
    blueprint = built.blueprint
    (row,) = [row for row in rows(bill_of_materials(blueprint)) if row["kind"] == "encoder"]
    assert (row["item"], row["quantity"]) == (blueprint.catalogue.joint_encoder.name, str(len(blueprint.seats)))
    assert row["mass_g"] == ""
    assert "(assumed); not in the mass model" in row["note"]


def test_every_motor_has_one_cable_and_one_address(built: Outcome) -> None:
    blueprint = built.blueprint
    table = rows(wiring_table(blueprint))
    assert [row["to"] for row in table] == [hinge.name for hinge in blueprint.hinges]
    assert len({(row["bus"], row["can_id"]) for row in table}) == len(blueprint.seats)
    for row, wire in zip(table, blueprint.wires, strict=True):
        assert float(row["length_mm"]) == pytest.approx(1e3 * wire.length, abs=0.5)


def test_addresses_never_repeat_and_stay_within_four_bits() -> None:
    addresses = [can_address(k) for k in range(40)]
    assert len(set(addresses)) == 40
    assert {number for _, number in addresses} == set(range(1, MAX_BUS + 1))


def test_the_sign_turns_with_the_side_that_holds_the_motor(built: Outcome) -> None:
    blueprint = built.blueprint
    for seat in blueprint.seats:
        hinge = blueprint.hinges[seat.hinge]
        assert turn_sign(blueprint, replace(seat, holder=hinge.parent, connector=hinge.body)) == 1
        assert turn_sign(blueprint, replace(seat, holder=hinge.body, connector=hinge.parent)) == -1
