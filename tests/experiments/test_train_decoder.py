"""`bodyplan train-decoder`: sittings that add up to one training, files that are whole, and one line for every trouble.

The loop is tested on a training of sixteen numbers; the real one has its tests in tests/decoder.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import json
import os
import signal
import struct
import subprocess
import sys
import types
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from decoder.design import VoxelDesign
from decoder.weights import load_weights
from experiments import decoder_training
from experiments.decoder_config import CURVE_SEED, TrainDecoder, load_decoder_config
from experiments.decoder_folder import Curve, Mark, check_training_folder, read_checkpoint, read_curve, write_checkpoint
from experiments.decoder_training import Stop, furthest, stoppable, train
from experiments.output import BadInput

CONFIGS = Path(decoder_training.__file__).parent / "configs"
BODIES = 3


@dataclass(frozen=True)
class Settings:
    seed: int
    steps: int
    flow_steps: int
    batch: int
    learning_rate: float
    warmup: int
    ema: float
    precision: str
    device: str
    threads: int
    start_bodies: int


class TrainingError(ValueError):
    pass


class Diverged(TrainingError):
    pass


class Training:
    """Sixteen numbers that follow the seed and the step."""

    bad_steps: tuple[int, ...] = ()
    diverges_at: int | None = None
    rounding: float = 0.0
    before_step = staticmethod(lambda _: None)

    def __init__(self, settings, numbers, step):
        self.settings, self.numbers, self.step = settings, numbers, step

    @classmethod
    def start(cls, settings, weights):
        return cls(settings, np.zeros(16) if weights is None else weights.arrays["numbers"].astype(float), 0)

    def advance(self):
        type(self).before_step(self.step)
        if self.step == self.diverges_at:
            raise Diverged("20 steps in a row were not finite")
        draw = np.random.default_rng([self.settings.seed, self.step]).standard_normal(16)
        self.step += 1
        if self.step in self.bad_steps:
            return {"total": float("nan"), "kl": 1.0}
        self.numbers = 0.9 * self.numbers + self.settings.learning_rate * draw
        total = 1.0 + float(np.square(self.numbers).sum())
        return {"total": total * (1 + self.rounding * (self.settings.precision == "bf16")), "kl": 1.0}

    def weights(self):
        return {"numbers": self.numbers.astype(np.float32)}

    def save(self, path):
        with path.open("wb") as file:
            np.save(file, np.append(self.numbers, self.step))

    @classmethod
    def load(cls, path, settings):
        *numbers, step = np.load(path)
        if len(numbers) != 16:
            raise TrainingError(f"{path}: not of this architecture")
        return cls(settings, np.array(numbers), int(step))


def module(name, **names):
    made = types.ModuleType(name)
    vars(made).update(names)
    return made


def stand_in():
    """A module like the real one, with a training of its own."""
    kind = type("Training", (Training,), {})
    names = {"Settings": Settings, "TrainingError": TrainingError, "Diverged": Diverged,
             "has_bf16": lambda device: device != "cpu"}  # fmt: skip
    return module("decoder.training", Training=kind, **names)


@pytest.fixture
def fake(monkeypatch):
    """The training of sixteen numbers in the place of the real one."""
    made = stand_in()
    monkeypatch.setitem(sys.modules, "decoder.training", made)
    monkeypatch.setattr("decoder.networks.shapes", lambda _: {"numbers": (16,)})
    return made.Training


def config(**changes):
    few = {"start": "scratch", "device": "cpu", "threads": 1, "steps": 18, "flow_steps": 2, "batch": BODIES,
           "checkpoint_every": 4, "evaluate_every": 6, "warmup": 1}  # fmt: skip
    return TrainDecoder("train-decoder", **(few | changes))


def measure(training):
    return {"body_iou": float(np.tanh(training.numbers.mean())), "missing": float("nan")}


def sit(settings, folder, stop_after=None, figures=measure):
    """One sitting, which ends after some steps."""
    folder.mkdir(exist_ok=True)
    steps = itertools.count(1)

    class After(Stop):
        def now(self):
            return next(steps) == stop_after

    return train(settings, folder, After(), figures)


def points(folder):
    """Every scalar of the event files as TensorBoard shows it: what was purged is left out."""
    from tensorboardX.proto.event_pb2 import Event, SessionLog

    shown: list[tuple[str, int, float]] = []
    files = sorted((folder / "events").iterdir(), key=lambda path: int(path.suffix[1:]))
    for path in files:
        data, at = path.read_bytes(), 0
        while at < len(data):
            (size,) = struct.unpack_from("<Q", data, at)
            event = Event.FromString(data[at + 12 : at + 12 + size])
            at += 16 + size
            if event.session_log.status == SessionLog.START:
                shown = [point for point in shown if point[1] < event.step]
            shown += [(value.tag, event.step, value.simple_value) for value in event.summary.value]
    return shown


# The configuration


@pytest.mark.parametrize("name", ["decoder_tiny", "decoder_cpu", "decoder_gpu"])
def test_the_configurations_are_good(name):
    loaded = load_decoder_config(CONFIGS / f"{name}.toml")
    assert loaded.warmup < loaded.steps
    assert loaded.evaluate_every <= loaded.steps


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", 'kind is missing; add a line kind = "train-decoder"'),
        ('kind = "evolve"', "give this file to `bodyplan run`"),
        ('kind = "x"', 'kind = "x"; it must be "train-decoder"'),
        ('kind = "train-decoder"\nsteps = "many"', 'steps = "many"; it must be a whole number in [1, 100000000]'),
        ('kind = "train-decoder"\nsteps = 0', "steps = 0; it must be a whole number in"),
        ('kind = "train-decoder"\nstep = 5', "unknown key step; did you mean steps?"),
        ('kind = "train-decoder"\nlearning_rate = nan', "learning_rate = nan; it must be a number in (0, 1]"),
        ('kind = "train-decoder"\ndevice = "gpu"', 'device = "gpu"; it must be "auto" | "cpu" | "cuda"'),
        ('kind = "train-decoder"\n[evaluation]\nbody = 5', "unknown key evaluation.body; did you mean bodies?"),
        ('kind = "train-decoder"\nwarmup = 10\nsteps = 10', "warmup = 10; it must be less than steps = 10"),
        (f'kind = "train-decoder"\nseed = {CURVE_SEED}', "that seed is kept for held-out bodies"),
        ('kind = "train-decoder"\nprecision = "fp8"', 'precision = "fp8"; it must be "auto" | "fp32" | "bf16"'),
        ("kind = ", "is not a TOML file"),
    ],
)
def test_a_bad_configuration_is_one_line(bodyplan, tmp_path, text, line):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    said = bodyplan("train-decoder", path, "--out", tmp_path / "out")
    assert said.status == 2
    assert said.err.count("\n") == 1
    assert line in said.err
    assert not (tmp_path / "out").exists()


def test_run_says_where_a_decoder_training_belongs(bodyplan, tmp_path):
    said = bodyplan("run", CONFIGS / "decoder_tiny.toml", "--out", tmp_path / "out")
    assert (said.status, said.err.count("\n")) == (2, 1)
    assert "give this file to `bodyplan train-decoder`" in said.err


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ([], "nothing to do: give a CONFIG.toml"),
        (["--evaluate", "--resume"], "--resume belongs to a training"),
        (["--evaluate", "--ship"], "--ship belongs to a training"),
        (["{tiny}", "--weights", "x"], "--weights names weights to measure without training"),
        (["{tiny}", "--seconds", "0"], "0 is out of bounds"),
        (["{tiny}", "--seconds", "soon"], "'soon' is not a number"),
        (["nowhere.toml"], "nowhere.toml: No such file"),
    ],
)
def test_a_bad_command_line_is_one_line(bodyplan, words, line):
    said = bodyplan("train-decoder", *(word.format(tiny=CONFIGS / "decoder_tiny.toml") for word in words))
    assert (said.status, said.err.count("\n")) == (2, 1)
    assert line in said.err


# The loop


@pytest.mark.parametrize("cuts", [(1,), (5, 3, 7), (6, 6)])
def test_sittings_add_up_to_one_training(fake, tmp_path, cuts):
    whole, _ = sit(config(), tmp_path / "whole")
    for cut in cuts:
        _, mark = sit(config(), tmp_path / "cut", stop_after=cut)
    assert mark.step == sum(cuts)
    parts, mark = sit(config(), tmp_path / "cut")
    assert parts.numbers.tobytes() == whole.numbers.tobytes()
    assert (mark.step, mark.bodies) == (20, 20 * BODIES)
    states = [next((tmp_path / name / "checkpoint").glob("*.state")).read_bytes() for name in ("whole", "cut")]
    assert states[0] == states[1]
    for name in ("whole", "cut"):
        assert [row["step"] for row in read_curve(tmp_path / name / "curve.csv")] == [6, 12, 18, 20]
    assert (tmp_path / "cut" / "curve.png").read_bytes().startswith(b"\x89PNG")
    curves = [read_curve(tmp_path / name / "curve.csv") for name in ("whole", "cut")]
    assert [row["body_iou"] for row in curves[0]] == [row["body_iou"] for row in curves[1]]
    seconds = [row["seconds"] for row in curves[1]]
    assert seconds == sorted(seconds)


def test_a_crash_costs_what_came_after_the_checkpoint_and_shows_no_step_twice(fake, tmp_path):
    def crash(step):
        if step == 15:
            raise MemoryError

    whole, _ = sit(config(), tmp_path / "whole")
    fake.before_step = staticmethod(crash)
    with pytest.raises(MemoryError):
        sit(config(), tmp_path / "cut")
    assert read_checkpoint(tmp_path / "cut")[1].step == 12
    fake.before_step = staticmethod(lambda _: None)
    parts, _ = sit(config(), tmp_path / "cut")
    assert parts.numbers.tobytes() == whole.numbers.tobytes()
    assert [row["step"] for row in read_curve(tmp_path / "cut" / "curve.csv")] == [6, 12, 18, 20]
    shown = [(tag, step) for tag, step, _ in points(tmp_path / "cut")]
    assert len(shown) == len(set(shown))
    assert {step for tag, step in shown if tag == "loss/total"} == {10, 20}
    assert {step for tag, step in shown if tag == "held_out/body_iou"} == {6, 12, 18, 20}


def test_a_killed_process_leaves_a_training_that_goes_on(fake, tmp_path):
    whole, _ = sit(config(), tmp_path / "whole")
    code = f"""if True:
        import importlib.util, os, pathlib, signal, sys
        spec = importlib.util.spec_from_file_location("here", {__file__!r})
        here = sys.modules["here"] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(here)
        made = sys.modules["decoder.training"] = here.stand_in()
        made.Training.before_step = staticmethod(lambda step: step == 15 and os.kill(os.getpid(), signal.SIGKILL))
        here.sit(here.config(), pathlib.Path({str(tmp_path / "cut")!r}))
    """
    done = subprocess.run([sys.executable, "-c", code], cwd=CONFIGS.parent.parent, capture_output=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert read_checkpoint(tmp_path / "cut")[1].step == 12
    parts, _ = sit(config(), tmp_path / "cut")
    assert parts.numbers.tobytes() == whole.numbers.tobytes()
    shown = [(tag, step) for tag, step, _ in points(tmp_path / "cut")]
    assert len(shown) == len(set(shown))


def test_a_row_that_was_written_after_the_checkpoint_is_made_again(fake, tmp_path):
    sit(config(evaluate_every=5), tmp_path / "run", stop_after=5)
    curve = Curve(tmp_path / "run" / "curve.csv", 20)
    curve.add({"step": 7.0, "seconds": 99.0, "bodies": 1.0})
    sit(config(evaluate_every=5), tmp_path / "run")
    assert [row["step"] for row in read_curve(tmp_path / "run" / "curve.csv")] == [5, 10, 15, 20]


def test_a_finished_training_is_not_touched(fake, tmp_path):
    sit(config(), tmp_path / "run")
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "run").rglob("*")}
    training, mark = sit(config(), tmp_path / "run")
    assert (training.step, mark.step) == (20, 20)
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "run").rglob("*")} == before


@pytest.fixture
def python_minds_ctrl_c():
    """Tests that run in the background of a shell inherit that Ctrl-C is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("python_minds_ctrl_c")
def test_the_first_ctrl_c_finishes_the_step_and_the_second_does_not_wait(fake, tmp_path, capsys):
    fake.before_step = staticmethod(lambda step: os.kill(os.getpid(), signal.SIGINT) if step == 6 else None)
    (tmp_path / "run").mkdir()
    with stoppable(None) as stop:
        training, mark = train(config(), tmp_path / "run", stop, measure)
    assert (training.step, mark.step) == (7, 7)
    assert read_checkpoint(tmp_path / "run")[1].step == 7
    assert "stopping after this step" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with stoppable(None) as stop:
        os.kill(os.getpid(), signal.SIGTERM)
        assert stop.now()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)


def test_time_that_is_up_stops_after_a_step(fake, tmp_path):
    (tmp_path / "run").mkdir()
    with stoppable(1e-9) as stop:
        _, mark = train(config(), tmp_path / "run", stop, measure)
    assert mark.step == 1
    assert read_checkpoint(tmp_path / "run")[1].step == 1


def test_a_step_that_is_not_finite_is_told_once_and_counted(fake, tmp_path, capsys):
    fake.bad_steps = (3, 5)
    _, mark = sit(config(), tmp_path / "run")
    assert mark.skipped == 2
    assert capsys.readouterr().err.count("note: total was not finite in step 3: the step was skipped") == 1
    assert all(np.isfinite(row["loss_total"]) for row in read_curve(tmp_path / "run" / "curve.csv"))


def test_a_training_that_diverges_is_one_line_that_names_what_is_left(fake, tmp_path):
    fake.diverges_at = 10
    with pytest.raises(BadInput, match=r"diverged after step 10: 20 steps in a row.*the checkpoint of step 8 is kept"):
        sit(config(), tmp_path / "run")
    fake.diverges_at = 1
    with pytest.raises(BadInput, match="no checkpoint was written"):
        sit(config(), tmp_path / "other")


def test_sittings_of_the_real_training_add_up(tmp_path):
    pytest.importorskip("decoder.training")
    few = config(steps=3, flow_steps=1, batch=2, checkpoint_every=2, evaluate_every=4)
    whole, _ = sit(few, tmp_path / "whole", figures=lambda _: {})
    sit(few, tmp_path / "cut", stop_after=1, figures=lambda _: {})
    parts, mark = sit(few, tmp_path / "cut", figures=lambda _: {})
    assert mark.step == 4
    one, two = whole.weights(), parts.weights()
    assert {name: array.tobytes() for name, array in one.items()} == {name: a.tobytes() for name, a in two.items()}


# What another precision may differ by


def test_the_term_that_differs_most_is_found():
    name, gap = furthest({"total": 2.0, "kl": 1.0}, {"total": 2.02, "kl": 1.04})
    assert name == "kl"
    assert gap == pytest.approx(0.04)
    assert furthest({"total": 1.0, "tiny": 1e-9}, {"total": 1.0, "tiny": 1e-3})[1] == pytest.approx(0.01, rel=1e-3)
    assert furthest({"total": 1.0}, {"total": float("nan")})[1] == np.inf
    assert furthest({"total": 1.0, "kl": 0.0}, {"total": 1.0})[1] == np.inf
    assert furthest({"total": 0.0}, {"total": 0.0})[1] == 0.0


@pytest.mark.parametrize(("rounding", "precision"), [(0.01, "bf16"), (0.2, "fp32")])
def test_bf16_is_trusted_only_if_it_agrees(fake, tmp_path, monkeypatch, capsys, rounding, precision):
    fake.rounding = rounding
    monkeypatch.setattr(decoder_training, "_device", lambda _: ("cuda", "a GPU"))
    _, mark = sit(config(device="auto"), tmp_path / "run", stop_after=2)
    assert mark.precision == precision
    told = capsys.readouterr().err
    assert "bf16 against fp32 on one batch: total differs most" in told
    assert ("so this training uses fp32" in told) == (precision == "fp32")
    _, mark = sit(config(device="auto"), tmp_path / "run", stop_after=2)
    assert mark.precision == precision  # and the next sitting goes on as the first did
    assert "one batch" not in capsys.readouterr().err


def test_a_cpu_uses_bf16_where_that_is_faster_or_asked_for(fake, tmp_path, monkeypatch):
    assert sit(config(), tmp_path / "slow", stop_after=2)[1].precision == "fp32"
    assert sit(config(precision="bf16"), tmp_path / "asked", stop_after=2)[1].precision == "bf16"
    monkeypatch.setattr(sys.modules["decoder.training"], "has_bf16", lambda _: True)
    assert sit(config(), tmp_path / "fast", stop_after=2)[1].precision == "bf16"
    assert sit(config(precision="fp32"), tmp_path / "not", stop_after=2)[1].precision == "fp32"


def test_going_on_elsewhere_is_told(fake, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(decoder_training, "_device", lambda _: ("cuda", "a GPU"))
    sit(config(device="auto"), tmp_path / "run", stop_after=2)
    monkeypatch.setattr(decoder_training, "_device", lambda _: ("cpu", "1 CPU thread"))
    _, mark = sit(config(), tmp_path / "run")
    assert (mark.device, mark.precision, mark.step) == ("cpu", "fp32", 20)
    assert "note: device was cuda and is now cpu; precision was bf16 and is now fp32" in capsys.readouterr().err


# The folder


MARK = Mark(4, 1.5, 12, "cpu", "fp32", 1, "1 CPU thread", "scratch")


def test_a_checkpoint_comes_back_and_the_one_before_it_goes(tmp_path):
    write_checkpoint(tmp_path, lambda path: path.write_bytes(b"old"), MARK)
    write_checkpoint(tmp_path, lambda path: path.write_bytes(b"state"), Mark(**{**vars_of(MARK), "step": 9}))
    path, mark = read_checkpoint(tmp_path)
    assert (path.read_bytes(), mark.step) == (b"state", 9)
    assert len(list((tmp_path / "checkpoint").iterdir())) == 2


def vars_of(mark):
    return {name: getattr(mark, name) for name in Mark.__slots__}


def test_a_crash_while_saving_leaves_the_checkpoint_before(tmp_path):
    write_checkpoint(tmp_path, lambda path: path.write_bytes(b"old"), MARK)

    def fails(path):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        write_checkpoint(tmp_path, fails, Mark(**{**vars_of(MARK), "step": 8}))
    assert read_checkpoint(tmp_path)[0].read_bytes() == b"old"


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (lambda d: next(d.glob("*.state")).unlink(), "is missing"),
        (lambda d: next(d.glob("*.state")).write_bytes(b"other"), "its SHA-256 is not the recorded one"),
        (lambda d: next(d.glob("*.state")).write_bytes(b""), "its SHA-256 is not the recorded one"),
        (lambda d: (d / "checkpoint.json").write_text("{"), "checkpoint.json is damaged"),
        (lambda d: (d / "checkpoint.json").write_text("[1]"), "is not the mark of a decoder training"),
        (lambda d: edit(d, version=9), "has version 9, this program reads 1"),
        (lambda d: edit(d, file="../../x"), "it names no file"),
        (lambda d: edit(d, step=-1), "step is -1"),
        (lambda d: edit(d, seconds="long"), "seconds is 'long'"),
        (lambda d: edit(d, device=None), "device is None"),
    ],
)
def test_a_spoilt_checkpoint_is_one_line(tmp_path, spoil, line):
    write_checkpoint(tmp_path, lambda path: path.write_bytes(b"state"), MARK)
    spoil(tmp_path / "checkpoint")
    with pytest.raises(BadInput) as caught:
        read_checkpoint(tmp_path)
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def edit(folder, **changes):
    path = folder / "checkpoint.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def test_a_mark_of_another_step_than_its_state_is_refused(fake, tmp_path):
    sit(config(), tmp_path / "run", stop_after=3)
    edit(tmp_path / "run" / "checkpoint", step=5)
    with pytest.raises(BadInput, match="is of step 3 and its mark says 5"):
        sit(config(), tmp_path / "run")


def test_a_checkpoint_of_another_architecture_is_one_line(fake, tmp_path):
    write_checkpoint(tmp_path, lambda path: path.write_bytes(npy(np.zeros(4))), MARK)
    with pytest.raises(BadInput, match="not of this architecture"):
        sit(config(), tmp_path)


def npy(array):
    data = io.BytesIO()
    np.save(data, array)
    return data.getvalue()


def test_a_folder_is_used_by_one_configuration(fake, tmp_path):
    sit(config(), tmp_path / "run", stop_after=3)
    check_training_folder(config(), tmp_path / "run", resume=True)
    check_training_folder(config(checkpoint_every=9, threads=2), tmp_path / "run", resume=True)
    with pytest.raises(BadInput, match="go on with it by --resume"):
        check_training_folder(config(), tmp_path / "run", resume=False)
    with pytest.raises(BadInput, match="another configuration: batch was 3 and is now 4"):
        check_training_folder(config(batch=4), tmp_path / "run", resume=True)


def test_the_folder_of_another_run_is_refused(tmp_path):
    (tmp_path / "run.sqlite").write_bytes(b"")
    with pytest.raises(BadInput, match=r"holds run.sqlite of another run"):
        check_training_folder(config(), tmp_path, resume=True)
    (tmp_path / "run.sqlite").unlink()
    (tmp_path / "config.toml").write_text('kind = "study"\n')
    with pytest.raises(BadInput, match="may hold another run"):
        check_training_folder(config(), tmp_path, resume=True)
    (tmp_path / "config.toml").unlink()
    (tmp_path / "vae.safetensors").write_bytes(b"")
    with pytest.raises(BadInput, match=r"holds vae.safetensors of another run"):
        check_training_folder(config(), tmp_path, resume=False)


def test_the_curve_gives_back_what_it_was_given(tmp_path):
    curve = Curve(tmp_path / "curve.csv", 0)
    curve.add({"step": 1.0, "seconds": 2.5, "bodies": 8.0, "loss_total": 0.25})
    curve.add({"step": 2.0, "seconds": 5.0, "bodies": 16.0, "loss_total": 0.2, "late": 1.0, "never": float("nan")})
    rows = read_curve(tmp_path / "curve.csv")
    assert rows[0] == {"step": 1.0, "seconds": 2.5, "bodies": 8.0, "loss_total": 0.25}
    assert rows[1]["late"] == 1.0
    assert "never" not in rows[1]
    with (tmp_path / "curve.csv").open(newline="") as file:
        assert next(csv.reader(file)) == ["step", "seconds", "bodies", "loss_total", "late", "never"]
    assert Curve(tmp_path / "curve.csv", 1).rows == rows[:1]


@pytest.mark.parametrize("text", ["step,seconds,bodies\n1,2,x\n", "a,b\n1,2\n", "step,seconds,bodies\n1,2,3,4\n"])
def test_a_spoilt_curve_is_one_line(tmp_path, text):
    (tmp_path / "curve.csv").write_text(text)
    with pytest.raises(BadInput, match="remove it, and the curve goes on without its past"):
        read_curve(tmp_path / "curve.csv")


# The whole command


TINY = CONFIGS / "decoder_tiny.toml"


class Codec:
    """Gives the same body for every latent: as it was, or moved by one voxel if the first number says so."""

    threshold = float("inf")
    as_it_was: VoxelDesign
    moved: VoxelDesign

    def __init__(self, weights):
        self.body = self.moved if weights.arrays["numbers"][0] > self.threshold else self.as_it_was

    def encode(self, designs):
        return np.zeros((len(designs), 512), np.float32)

    def decode(self, latents):
        return [self.body] * len(latents)


@pytest.fixture
def whole(fake, hinge, tmp_path, monkeypatch):
    """Everything that is slow replaced, and an empty package to ship to."""
    import decoder.weights
    from experiments import decoder_card, decoder_result

    def write_card(codec, weights, out, pictures, **options):
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(f"{weights.sha256} {options['name']} {options['n']} {options['curve'] is not None}")
        return decoder_result.measure(codec, 2, 2)

    monkeypatch.setitem(sys.modules, "decoder.vae", module("decoder.vae", VaeDecoder=Codec))
    drawn = module("decoder.synthetic", sample_designs=lambda n, _: [hinge] * n)
    monkeypatch.setitem(sys.modules, "decoder.synthetic", drawn)
    monkeypatch.setattr(decoder_result, "PAIRS", 0)  # interpolating is what takes longest
    monkeypatch.setattr(decoder_result, "CURVE_PAIRS", 0)
    monkeypatch.setattr("analysis.plots.training_curve", lambda *_: b"a picture")
    monkeypatch.setattr(decoder_card, "write_card", write_card)
    monkeypatch.setattr(decoder_card, "CARD", tmp_path / "package" / "MODEL_CARD.md")
    monkeypatch.setattr(decoder_card, "PICTURES", tmp_path / "package" / "pictures")
    monkeypatch.setattr(decoder.weights, "SHIPPED", tmp_path / "package" / "weights" / "vae.safetensors")
    monkeypatch.setattr(decoder.weights, "DIGEST", tmp_path / "package" / "weights" / "vae.sha256")
    moved = {name: np.roll(getattr(hinge, name), 1, 0) for name in ("material", "segment")}
    monkeypatch.setattr(Codec, "as_it_was", hinge, raising=False)
    monkeypatch.setattr(Codec, "moved", dataclasses.replace(hinge, **moved), raising=False)
    monkeypatch.setattr(Codec, "threshold", float("inf"))
    (tmp_path / "package").mkdir()
    return tmp_path


def test_a_training_leaves_weights_figures_and_a_curve(bodyplan, whole):
    said = bodyplan("train-decoder", TINY, "--out", whole / "run", "--json")
    assert said.status == 0, said.err
    told = json.loads(said.out)
    assert (told["finished"], told["step"], told["steps"], told["bodies"]) == (True, 6, 6, 12)
    assert (told["device"], told["precision"], told["start"]) == ("cpu", "fp32", "scratch")
    assert told["figures"]["body_iou"] == 1.0
    assert {goal["name"]: goal["reached"] for goal in told["goals"]}["body IoU"]
    found = load_weights(whole / "run" / "vae.safetensors")
    assert found.sha256 == told["sha256"]
    assert (found.about["bodies_seen"], found.about["steps"], found.about["started_from"]) == ("12", "6", "scratch")
    assert json.loads((whole / "run" / "result.json").read_text())["figures"] == told["figures"]
    assert [row["step"] for row in read_curve(whole / "run" / "curve.csv")] == [3, 6]
    assert {"body_iou", "prior_one_tree", "joint_recall", "loss_kl"} <= set(read_curve(whole / "run" / "curve.csv")[0])
    assert f"use them by --decoder {whole / 'run' / 'vae.safetensors'}" in said.err


def test_sittings_of_the_command_add_up(bodyplan, whole):
    one = json.loads(bodyplan("train-decoder", TINY, "--out", whole / "one", "--json").out)
    words = ["train-decoder", TINY, "--out", whole / "cut", "--seconds", "1e-6"]
    said = bodyplan(*words)
    assert (said.status, said.out) == (3, "")
    again = f"Go on with: bodyplan train-decoder {TINY} --out {whole / 'cut'} --resume --seconds 1e-06"
    assert f"1e-06 s are over at step 1 of 6; everything is saved. {again}" in said.err
    said = bodyplan(*words)
    assert (said.status, said.err.count("\n")) == (2, 1)
    assert "go on with it by --resume" in said.err
    statuses = []
    while not statuses or (statuses[-1] == 3 and len(statuses) < 10):
        said = bodyplan(*words, "--resume", "--json")
        statuses.append(said.status)
        assert json.loads(said.out)["finished"] == (said.status == 0)
    assert statuses == [3, 3, 3, 3, 3, 0]  # the last sitting only measures
    assert json.loads(said.out)["figures"] == one["figures"]
    a, b = (load_weights(whole / name / "vae.safetensors").arrays["numbers"] for name in ("one", "cut"))
    assert a.tobytes() == b.tobytes()
    before = (whole / "cut" / "result.json").stat().st_mtime_ns
    assert bodyplan("train-decoder", TINY, "--out", whole / "cut", "--resume").status == 0
    assert (whole / "cut" / "result.json").stat().st_mtime_ns == before


def test_ctrl_c_in_the_closing_evaluation_can_be_resumed(bodyplan, whole, monkeypatch):
    from experiments import decoder_result

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(decoder_result, "measure", interrupted)
        said = bodyplan("train-decoder", TINY, "--out", whole / "run", "--ship")
    assert said.status == 3
    assert f"Go on with: bodyplan train-decoder {TINY} --out {whole / 'run'} --resume --ship" in said.err
    said = bodyplan("train-decoder", TINY, "--out", whole / "run", "--resume", "--ship")
    assert said.status == 0
    assert "the package has the new weights: the package had none" in said.err


def test_the_package_keeps_the_better_weights(bodyplan, whole, monkeypatch):
    from decoder.weights import DIGEST, SHIPPED

    def trained(name, *words, seed=0):
        (whole / "c.toml").write_text(TINY.read_text().replace("[evaluation]", f"seed = {seed}\n\n[evaluation]"))
        said = bodyplan("train-decoder", whole / "c.toml", "--out", whole / name, "--json", *words)
        assert said.status == 0, said.err
        return json.loads(said.out)

    one, two = trained("one", seed=1), trained("two", seed=2)
    assert not SHIPPED.exists()
    first = {name: load_weights(whole / name / "vae.safetensors").arrays["numbers"][0] for name in ("one", "two")}
    worse, best = sorted(first, key=lambda name: -first[name])
    seeds = {"one": 1, "two": 2}
    digests = {"one": one["sha256"], "two": two["sha256"]}
    monkeypatch.setattr(Codec, "threshold", float(np.mean(list(first.values()))))
    for name in first:
        (whole / name / "result.json").unlink()  # it was of the codec before
    assert trained(worse, "--resume", "--ship", seed=seeds[worse])["shipped"]["kept"] == "new"
    assert load_weights(SHIPPED).sha256 == digests[worse]
    told = trained(best, "--resume", "--ship", seed=seeds[best])["shipped"]
    assert told["kept"] == "new"
    assert "they differ most in" in told["why"]
    assert load_weights(SHIPPED).sha256 == digests[best]
    assert DIGEST.read_text() == f"{digests[best]}  vae.safetensors\n"
    assert trained(worse, "--resume", "--ship", seed=seeds[worse])["shipped"]["kept"] == "old"
    assert load_weights(SHIPPED).sha256 == digests[best]
    told = trained(best, "--resume", "--ship", seed=seeds[best])["shipped"]
    assert told["why"] == "the package has these very weights already"


def test_a_training_goes_on_from_the_package_and_adds_up_what_was_seen(bodyplan, whole):
    from decoder.weights import SHIPPED

    text = TINY.read_text()
    assert bodyplan("train-decoder", TINY, "--out", whole / "one", "--ship").status == 0
    (whole / "more.toml").write_text(text.replace('start = "scratch"', 'start = "shipped"'))
    said = bodyplan("train-decoder", whole / "more.toml", "--out", whole / "two", "--json")
    assert said.status == 0, said.err
    shipped = load_weights(SHIPPED)
    assert json.loads(said.out)["start"] == shipped.sha256
    about = load_weights(whole / "two" / "vae.safetensors").about
    assert (about["bodies_seen"], about["steps"]) == ("24", "12")
    assert about["started_from"] == f"weights {shipped.sha256[:16]}"
    SHIPPED.write_bytes(SHIPPED.read_bytes()[:-7])
    said = bodyplan("train-decoder", whole / "more.toml", "--out", whole / "three")
    assert (said.status, said.err.count("\n")) == (2, 1)
    assert str(SHIPPED) in said.err
    assert not (whole / "three" / "config.toml").exists()


def test_without_weights_to_go_on_from_it_starts_from_scratch_and_says_so(bodyplan, whole):
    (whole / "c.toml").write_text(TINY.read_text().replace('start = "scratch"\n', ""))
    said = bodyplan("train-decoder", whole / "c.toml", "--out", whole / "run", "--json")
    assert said.status == 0
    assert "is not there to go on from, so this training starts from scratch" in said.err
    assert json.loads(said.out)["start"] == "scratch"


def test_the_card_lies_with_its_weights(bodyplan, whole):
    said = bodyplan("train-decoder", "--evaluate")
    assert (said.status, said.err.count("\n")) == (2, 1)
    assert "vae.safetensors is missing" in said.err
    said = bodyplan("train-decoder", TINY, "--out", whole / "run", "--evaluate", "--json")
    assert said.status == 0, said.err
    digest, card = json.loads(said.out)["sha256"], whole / "run" / "MODEL_CARD.md"
    assert json.loads(said.out)["card"] == str(card)
    assert card.read_text() == f"{digest} {whole / 'run' / 'vae.safetensors'} 2 True"
    said = bodyplan("train-decoder", "--evaluate", "--weights", whole / "run" / "vae.safetensors", "--out", whole / "x")
    assert said.status == 0, said.err
    assert (whole / "x" / "MODEL_CARD.md").read_text().endswith("500 False")
    said = bodyplan("train-decoder", TINY, "--out", whole / "run", "--resume", "--ship", "--evaluate")
    assert said.status == 0, said.err
    assert (whole / "package" / "MODEL_CARD.md").read_text() == f"{digest} vae 2 True"
    assert bodyplan("train-decoder", "--evaluate", "--json").status == 0
    assert (whole / "package" / "MODEL_CARD.md").read_text() == f"{digest} vae 500 False"


def test_foreign_weights_are_one_line(bodyplan, whole):
    (whole / "x.safetensors").write_bytes(b"not weights")
    said = bodyplan("train-decoder", "--evaluate", "--weights", whole / "x.safetensors")
    assert (said.status, said.err.count("\n")) == (2, 1)
    assert "not a readable safetensors file" in said.err


def test_the_top_of_the_command_loads_no_torch():
    code = "import sys, experiments.train_decoder; print({'torch', 'numpy', 'msgspec'} & set(sys.modules))"
    shown = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=CONFIGS.parent.parent
    )
    assert shown.stdout.strip() == "set()"
