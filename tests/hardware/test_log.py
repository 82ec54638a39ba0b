import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from hardware import j60
from hardware.bundle import Bundle
from hardware.control import drive
from hardware.log import LogError, play_back, read_log, states_path
from hardware.tick import Tick
from hardware.virtual import Imperfection
from sim.actor import Gait

Make = Callable[..., Any]


def record(make_rig: Make, path: Path, watch: Callable[[Any, Tick], None] | None = None, **options: Any) -> Any:
    rig = make_rig(journal=path, **options)
    with rig.journal:
        drive(rig.robot, rig.motors, rig.motors.imu, rig.journal, lambda t: watch(rig, t) if watch else None)
    return rig


def test_an_undisturbed_run_plays_back_to_the_last_frame(make_rig: Make, tmp_path: Path) -> None:
    record(make_rig, tmp_path / "run.log")
    log = read_log(tmp_path / "run.log")
    compared, divergence = play_back(log)
    assert divergence is None
    assert compared == len(log.frames) > 1500


@pytest.mark.parametrize(
    "imperfection", [Imperfection(drop=0.03), Imperfection(delay=0.012), Imperfection(0.02, 0.007)]
)
def test_so_does_a_disturbed_one(make_rig: Make, tmp_path: Path, imperfection: Imperfection) -> None:
    record(make_rig, tmp_path / "run.log", imperfection=imperfection)
    log = read_log(tmp_path / "run.log")
    assert play_back(log) == (len(log.frames), None)


def test_so_does_one_that_a_guard_stopped(make_rig: Make, tmp_path: Path) -> None:
    def tip(rig: Any, tick: Tick) -> None:
        if tick.index == 150:
            rig.plant.gravity = np.array([1.0, 0.0, 0.0])

    record(make_rig, tmp_path / "run.log", tip)
    log = read_log(tmp_path / "run.log")
    assert play_back(log) == (len(log.frames), None)
    last = json.loads(states_path(tmp_path / "run.log").read_text().splitlines()[-1])
    assert last["latched"]["guard"] == "tilt"


def test_another_gait_diverges_at_the_first_period_where_it_matters(
    make_rig: Make, tmp_path: Path, bundle: Bundle
) -> None:
    record(make_rig, tmp_path / "run.log")
    gait = bundle.actor
    other = Gait(gait.frequency, gait.amplitude + np.array([0.0, 0.0, 0.3]), gait.phase, gait.offset)
    log = read_log(tmp_path / "run.log")
    compared, divergence = play_back(log, replace(bundle, actor=other))
    assert divergence is not None
    assert 0 < compared < len(log.frames)
    found = divergence.as_json(bundle)
    assert found["joint"] == "ankle"
    assert 131 < found["tick"] < 141  # the policy starts at 131, blended in
    assert found["logged"]["position"] != found["recomputed"]["position"]


def test_a_tampered_reply_shows_where_it_changes_an_action(make_rig: Make, tmp_path: Path, bundle: Bundle) -> None:
    path = tmp_path / "run.log"
    record(make_rig, path)
    lines = path.read_text().splitlines()
    replies = [i for i, line in enumerate(lines) if f" {j60.reply_id(j60.Code.CONTROL, 3):03X}#" in line]
    fake = j60.encode_reply(j60.Reply(1.1, 0.0, 0.0, 25.0, True)).hex().upper()
    victim = replies[6]  # after one at bring-up, the measurement from which the ramp starts
    lines[victim] = lines[victim].partition("#")[0] + f"#{fake} R"
    path.write_text("\n".join(lines) + "\n")
    _, divergence = play_back(read_log(path))
    assert divergence is not None
    assert divergence.as_json(bundle)["joint"] == "hip"
    assert divergence.tick == 6


def test_python_can_reads_the_frames(make_rig: Make, tmp_path: Path) -> None:
    record(make_rig, tmp_path / "run.log")
    messages = list(can.CanutilsLogReader(tmp_path / "run.log"))
    log = read_log(tmp_path / "run.log")
    assert len(messages) == len(log.frames)
    for message, logged in zip(messages, log.frames, strict=True):
        assert (message.arbitration_id, bytes(message.data)) == (logged.frame.can_id, logged.frame.data)
        assert message.timestamp == pytest.approx(logged.time)
        assert message.is_rx is not logged.sent


def test_a_log_cut_off_in_the_middle_still_plays(make_rig: Make, tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    record(make_rig, path)
    for file in (path, states_path(path)):
        text = file.read_text()
        file.write_text(text[: len(text) * 2 // 3])
    log = read_log(path)
    compared, divergence = play_back(log)
    assert compared > 0
    assert divergence is None or divergence.logged is None  # it can only run out of frames


def test_what_is_no_log_is_one_clear_line(make_rig: Make, tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    with pytest.raises(LogError, match="does not exist"):
        read_log(path)
    record(make_rig, path)
    frames, states = path.read_text(), states_path(path).read_text()
    for damaged, where, message in [
        ("hello\n", path, "line 1 is not a frame: 'hello'"),
        ("\xff\n", path, "not a text file"),
        ("{\n", states_path(path), "line 1 is not JSON"),
        ('{"version": 9}\n', states_path(path), "version must be 1, got 9"),
        ("[]\n", states_path(path), "not the record of a run"),
        ("", states_path(path), "not the record of a run"),
        (states.replace('"tilt": 1.4', '"tilted": 1.4', 1), states_path(path), "not the record of a run"),
    ]:
        path.write_text(frames)
        states_path(path).write_text(states)
        where.write_text(damaged, encoding="latin-1")
        with pytest.raises(LogError, match=message):
            read_log(path)
