from __future__ import annotations

import csv
import io
from dataclasses import replace

import numpy as np
import pytest

from mfg.addresses import MAX_BUS, can_address, turn_sign
from mfg.blueprint import Crossing
from mfg.masses import body_masses
from mfg.pipeline import Outcome
from mfg.slicer import PlateSlice, SliceReport
from mfg.tables import SLICED, bill_of_materials, sliced_bill, wiring_table


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
        assert float(row["length_mm"]) == pytest.approx(1e3 * wire.cable_length, abs=0.5)


def test_the_slack_in_a_cable_is_named_by_joint(built: Outcome) -> None:
    blueprint = built.blueprint
    first, second = blueprint.wires
    crossings = tuple(
        Crossing(hinge, np.zeros(3), 0.02, (0.02, 0.03), slack) for hinge, slack in ((1, 0.012), (0, 0.02))
    )
    slack = replace(blueprint, wires=(replace(first, crossings=crossings), replace(second, crossings=())))
    a, b = rows(wiring_table(slack))
    assert (a["slack_mm"], b["slack_mm"]) == ("joint_2:12 joint_1:20", "")
    assert float(a["length_mm"]) == pytest.approx(1e3 * first.length + 32, abs=0.5)
    assert float(b["length_mm"]) == pytest.approx(1e3 * second.length, abs=0.5)


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


def test_a_slicer_adds_its_grams_once_and_changes_nothing_else() -> None:
    bill = 'kind,item,quantity,unit,mass_g,note\nmotor,M,2,pcs,960.0,"a, b"\nfilament,PLA,500,g,500.0,rigid\n'
    first = SliceReport("PrusaSlicer 1", (PlateSlice(0, ("a",), 3600.0, (10.0, 5.0), ()),
                                          PlateSlice(1, ("b",), 5430.0, (20.4, 0.0), ())))  # fmt: skip
    once = sliced_bill(bill, first, ("PLA", "TPU"))
    assert once.startswith(bill)
    added = [row for row in rows(once) if row["kind"] == SLICED]
    assert [(row["item"], row["quantity"], row["mass_g"]) for row in added] == [("PLA", "30", ""), ("TPU", "5", "")]
    assert "2 h 30 min" in added[0]["note"]
    second = SliceReport("PrusaSlicer 2", (PlateSlice(0, ("a",), 60.0, (1.0, 2.0), ()),))
    assert sliced_bill(once, second, ("PLA", "TPU")) == sliced_bill(bill, second, ("PLA", "TPU"))
