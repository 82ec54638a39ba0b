"""The slicer's door: what it says is read right, and whatever it does wrong is one clear reason."""

from __future__ import annotations

import hashlib
import re
import signal
import subprocess
import sys
import time
import zipfile
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from mfg.manifest import FORMAT, NAME, VERSION, manifest_bytes
from mfg.moments import printed_moments
from mfg.parts import H2D, PAPER, PLA, TPU_90A
from mfg.slicer import SliceError, SliceReport, clock, find_slicer, slice_blueprint
from mfg.solids import box
from mfg.stl import MM_PER_M, welded
from mfg.threemf import PLATE_STRIDE, PrintObject, Volume, prusa_3mf

FOOTER = r"; filament used [g] = 12.50, 3.25\n; estimated printing time (normal mode) = 1d 2h 3m 4s\n"
real = pytest.mark.skipif(find_slicer() is None, reason="needs PrusaSlicer")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The least blueprint to slice: a soft jacket around a rigid block, and the block alone on another plate."""
    inner, outer = box((0.005, 0.005, 0), (0.015, 0.015, 0.01)), box((0, 0, 0), (0.02, 0.02, 0.01))
    bone, skin = Volume("bone", *welded(inner), 1, PLA), Volume("skin", *welded(outer - inner), 2, TPU_90A)
    objects = []
    for plate, volumes in enumerate([(bone, skin), (bone,)]):
        pose = np.eye(4)
        pose[:3, 3] = 100 + plate * H2D.volume[0] * PLATE_STRIDE * MM_PER_M, 120, 0
        objects.append(PrintObject(f"body_{plate}", volumes, pose, plate))
    place = tmp_path_factory.mktemp("least")
    data = prusa_3mf(objects, "t", PAPER)
    (place / "print.3mf").write_bytes(data)
    document = {
        "format": FORMAT, "version": VERSION, "catalogue": asdict(PAPER),
        "bodies": [{"name": "body_0", "plate": 0}, {"name": "body_1", "plate": 1}],
        "files": {"print.3mf": hashlib.sha256(data).hexdigest()},
    }  # fmt: skip
    (place / NAME).write_bytes(manifest_bytes(document))
    return place


def program(tmp_path: Path, text: str) -> Path:
    """A shell script in the place of PrusaSlicer; $out is where the G-code goes, $in the file to slice."""
    place = tmp_path / "slicer.sh"
    place.write_text(
        '#!/bin/sh\nif [ "$1" = --help ]; then echo "PrusaSlicer-2.5.0+fake based on Slic3r"; exit 0; fi\n'
        f'while [ $# -gt 1 ]; do [ "$1" = --output ] && out=$2; shift; done\nin=$1\n{text}\n'
    )
    place.chmod(0o755)
    return place


def test_time_grams_and_warnings_are_read_for_every_plate(folder: Path, tmp_path: Path) -> None:
    fake = program(
        tmp_path,
        f"""printf '{FOOTER}' > $out
echo "10 => Processing triangulated mesh"
echo "[2026-01-01 10:00:00.1] [0x00007f0000000000] [warning] Empty layers   detected"
echo "[2026-01-01 10:00:00.1] [0x00007f0000000000] [trace]   Initializing"
echo "print warning: Consider enabling supports." >&2
echo "print warning: Consider enabling supports." >&2""",
    )
    report = slice_blueprint(folder, fake)
    assert report.program == "PrusaSlicer 2.5.0"
    assert [(p.plate, p.objects) for p in report.plates] == [(0, ("body_0",)), (1, ("body_1",))]
    assert all(p.seconds == ((26 * 60) + 3) * 60 + 4 for p in report.plates)
    assert report.grams == (25.0, 6.5)
    assert report.warnings == ("Empty layers detected", "Consider enabling supports.")
    assert report.to_json()["filament_g"] == {"rigid": 25.0, "soft": 6.5}


def test_the_slicer_gets_one_plate_at_its_true_place(folder: Path, tmp_path: Path) -> None:
    fake = program(tmp_path, f"cp \"$in\" {tmp_path}/seen_$(basename $in); printf '{FOOTER}' > $out")
    slice_blueprint(folder, fake)
    for plate in (0, 1):
        with zipfile.ZipFile(tmp_path / f"seen_plate_{plate + 1}.3mf") as seen:
            items = re.findall(
                r'<item [^>]*transform="([^"]*)" printable="(\d)"', seen.read("3D/3dmodel.model").decode()
            )
        assert [shown for _, shown in items] == [str(int(k == plate)) for k in (0, 1)]
        assert [float(v) for v in items[plate][0].split()[9:]] == pytest.approx([100, 120, 0])
        with (
            zipfile.ZipFile(folder / "print.3mf") as whole,
            zipfile.ZipFile(tmp_path / f"seen_plate_{plate + 1}.3mf") as s,
        ):
            assert set(whole.namelist()) == set(s.namelist())


@pytest.mark.parametrize(
    ("does", "said"),
    [
        ("echo 'Slicing impossible' >&2; exit 1", r"failed on plate 1 \(body_0\) with status 1: Slicing impossible"),
        ("kill -11 $$", "with signal 11"),
        ("echo 'Nothing to print'", "wrote no G-code for plate 1 .*Nothing to print"),
        ("printf 'G1 X0' > $out", "no printing time"),
        ("printf '; estimated printing time (normal mode) = soon\\n' > $out", "no printing time"),
        ("printf '; estimated printing time (normal mode) = \\n' > $out", "no printing time"),
        (
            "printf '; filament used [g] = 1.0\\n; estimated printing time (normal mode) = 5s\\n' > $out",
            "each filament",
        ),
        (
            "printf '; filament used [g] = nan, 1\\n; estimated printing time (normal mode) = 5s\\n' > $out",
            "each filament",
        ),
        (
            "printf '; filament used [g] = 0.0, 0.0\\n; estimated printing time (normal mode) = 5s\\n' > $out",
            "each filament",
        ),
        (
            "printf '; filament used [g] = 1, 2, 3\\n; estimated printing time (normal mode) = 5s\\n' > $out",
            "each filam",
        ),
        ("head -c 100000 /dev/urandom > $out", "no printing time"),
    ],
)
def test_whatever_a_slicer_does_wrong_is_one_line(folder: Path, tmp_path: Path, does: str, said: str) -> None:
    with pytest.raises(SliceError, match=said) as caught:
        slice_blueprint(folder, program(tmp_path, does))
    assert "\n" not in str(caught.value)


def test_a_slicer_that_hangs_is_stopped_with_all_that_it_started(folder: Path, tmp_path: Path) -> None:
    fake = program(tmp_path, f"(sleep 3; touch {tmp_path}/still_here) & wait")
    with pytest.raises(SliceError, match=r"stopped after 0\.5 s"):
        slice_blueprint(folder, fake, patience=0.5)
    time.sleep(4)
    assert not (tmp_path / "still_here").exists()


def test_a_terminated_program_leaves_no_slicer_behind(folder: Path, tmp_path: Path) -> None:
    """The signal reaches the program while it waits for the slicer; what a script started ends with it."""
    told = tmp_path / "pid"
    fake = program(tmp_path, f"sleep 600 & echo $! > {told}.new; mv {told}.new {told}; wait")
    code = (
        "import sys; from pathlib import Path; from mfg.slicer import slice_blueprint\n"
        "slice_blueprint(*map(Path, sys.argv[1:]))"
    )
    command = [sys.executable, "-c", code, str(folder), str(fake)]
    with subprocess.Popen(command, cwd=Path(__file__).parents[2]) as waiting:
        while not told.exists():
            assert waiting.poll() is None
            time.sleep(0.02)
        waiting.send_signal(signal.SIGTERM)
        assert waiting.wait(60) == 128 + signal.SIGTERM
    slicer = int(told.read_text())
    for _ in range(500):
        if not alive(slicer):
            return
        time.sleep(0.02)
    raise AssertionError("the slicer still runs")


def alive(process: int) -> bool:
    try:
        return " Z " not in Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False


@pytest.mark.parametrize("before", [signal.SIG_IGN, lambda *_: None])
def test_who_answers_the_signal_himself_goes_on_doing_so(folder: Path, tmp_path: Path, before: object) -> None:
    kept = signal.signal(signal.SIGTERM, before)  # type: ignore[arg-type]
    try:
        with pytest.raises(SliceError):
            slice_blueprint(folder, program(tmp_path, "exit 1"))
        assert signal.getsignal(signal.SIGTERM) is before
    finally:
        signal.signal(signal.SIGTERM, kept)


def test_no_slicer_another_program_or_none_at_all_is_said(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "other"
    other.write_text("#!/bin/sh\necho Cura 5\n")
    with pytest.raises(SliceError, match="does not run: Permission denied"):
        slice_blueprint(folder, other)
    other.chmod(0o755)
    with pytest.raises(SliceError, match="is not PrusaSlicer"):
        slice_blueprint(folder, other)
    with pytest.raises(SliceError, match="does not run: No such file"):
        slice_blueprint(folder, tmp_path / "nowhere")
    monkeypatch.setenv("PATH", str(tmp_path / "empty"))
    assert find_slicer() is None
    with pytest.raises(SliceError, match="get it with: apt install"):
        slice_blueprint(folder)


def test_a_print_file_that_is_not_the_blueprints_is_refused(folder: Path, tmp_path: Path) -> None:
    (tmp_path / NAME).write_bytes((folder / NAME).read_bytes())
    for content in (None, b"no archive"):
        if content is not None:
            (tmp_path / "print.3mf").write_bytes(content)
        with pytest.raises(SliceError, match=r"is not the file that blueprint\.json knows"):
            slice_blueprint(tmp_path, program(tmp_path, ""))


def test_a_clock_is_in_hours_and_minutes() -> None:
    assert [clock(s) for s in (0, 3599, 3600, 5430, 360000)] == [
        "0 h 00 min", "1 h 00 min", "1 h 00 min", "1 h 30 min", "100 h 00 min"
    ]  # fmt: skip


@pytest.fixture(scope="module")
def sliced(folder: Path) -> SliceReport:
    return slice_blueprint(folder)


@real
def test_prusaslicer_prints_each_part_of_its_own_filament(sliced: SliceReport) -> None:
    both, bone_only = sliced.plates
    assert both.grams[0] > 0
    assert both.grams[1] > 0
    assert bone_only.grams[1] == 0
    assert bone_only.seconds < both.seconds


@real
def test_prusaslicer_lays_down_what_the_mass_model_says(sliced: SliceReport) -> None:
    inner, outer = box((0.005, 0.005, 0), (0.015, 0.015, 0.01)), box((0, 0, 0), (0.02, 0.02, 0.01))
    jacket = outer - inner
    bone = 1e3 * printed_moments(inner.vertices, inner.triangles, PLA, H2D.line_width).mass
    skin = 1e3 * printed_moments(jacket.vertices, jacket.triangles, TPU_90A, H2D.line_width).mass
    # One cubic centimetre: whole lines and a skirt weigh more here than on a robot, so the bounds are wide.
    assert 0.6 * bone < sliced.plates[0].grams[0] < 2.0 * bone
    assert 0.5 * skin < sliced.plates[0].grams[1] < 2.0 * skin


@real
def test_the_estimates_of_prusaslicer_repeat(folder: Path, sliced: SliceReport) -> None:
    again = slice_blueprint(folder)
    for one, two in zip(sliced.plates, again.plates, strict=True):
        # Its threads may lay supports a little differently.
        assert two.grams == pytest.approx(one.grams, rel=0.01)
        assert two.seconds == pytest.approx(one.seconds, rel=0.01)
