"""A decoder training from its configuration into its folder: start or go on, step, measure, save, stop."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from experiments.decoder_config import TrainDecoder
from experiments.decoder_folder import (
    CURVE,
    CURVE_PICTURE,
    EVENTS,
    Curve,
    Mark,
    read_checkpoint,
    tell_differences,
    write_checkpoint,
)
from experiments.events import Events, event_file
from experiments.output import BadInput, progress, say
from experiments.run_folder import cores, keep_config

if TYPE_CHECKING:
    from decoder.training import Settings, Training
    from decoder.weights import Weights

# bf16 is trusted if no term of the loss on one batch is further than this from fp32, relative to the term or, for a
# small one, to a tenth of the largest. Rounding to 8 bits costs 0.4 % per number; 5 % is an error of another kind.
BF16_BOUND = 0.05
LOG_EVERY = 10  # steps between points of the curves for TensorBoard, each the mean since the last

Measure = Callable[["Training"], Mapping[str, float]]


@dataclasses.dataclass(slots=True)
class Stop:
    """Why to stop: a signal, or the time is up.

    Attributes:
        deadline: on the monotonic clock [s].
        signalled: set by Ctrl-C or a polite request to end.
    """

    deadline: float = math.inf
    signalled: bool = False

    def now(self) -> bool:
        """Whether to stop after this step."""
        return self.signalled or self.left() <= 0.0

    def left(self) -> float:
        """Seconds until the time is up."""
        return self.deadline - time.monotonic()


@contextlib.contextmanager
def stoppable(seconds: float | None) -> Iterator[Stop]:
    """Let a first Ctrl-C or SIGTERM only ask to stop, so that no step is cut in two; a second one interrupts at once.

    Args:
        seconds: until the time is up, None for no limit.
    """
    stop = Stop(math.inf if seconds is None else time.monotonic() + seconds)

    def ask(*_: object) -> None:
        if stop.signalled:
            raise KeyboardInterrupt
        stop.signalled = True
        say("\nstopping after this step; once more stops at once and loses what came after the last checkpoint")

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def train(config: TrainDecoder, folder: Path, stop: Stop, measure: Measure) -> tuple[Training, Mark]:
    """Take the steps that are missing, or those there is time for; the last act is always a checkpoint.

    Rows of the curve, points for TensorBoard and checkpoints fall on the same steps however often the training was
    stopped, and on a CPU its weights are the same bytes.

    Args:
        config: what to train; the folder was checked against it.
        folder: of the training, which exists.
        stop: asked after every step.
        measure: figures of the present weights, for the curve.

    Returns:
        the training, complete if the mark's step is the last.

    Raises:
        BadInput: if the device or the checkpoint cannot be used, or the training diverges.
        OSError: if the folder cannot be written.
    """
    from decoder.training import Diverged, TrainingError

    try:
        training, mark = _ready(config, folder)
    except TrainingError as error:
        raise BadInput(str(error)) from None
    keep_config(config, folder)
    sitting = _Sitting(config, folder, training, mark, measure)
    if mark.step == config.last_step:
        return training, mark
    say(f"{config.last_step - mark.step} steps to go of {config.batch} bodies each, {mark.precision} on {mark.machine}")
    try:
        with event_file(folder / EVENTS, mark.step) as log:
            for _ in progress(sitting.steps(log), config.last_step - mark.step, "training"):
                if stop.now():
                    break
    except Diverged as error:
        kept = read_checkpoint(folder)
        where = "no checkpoint was written" if kept is None else f"the checkpoint of step {kept[1].step} is kept"
        raise BadInput(f"the training diverged after step {sitting.mark.step}: {error}; {where}; lower learning_rate "
                       'or write precision = "fp32", and choose another --out') from None  # fmt: skip
    sitting.save()
    sitting.curve.draw(folder / CURVE_PICTURE)
    return training, sitting.mark


class _Sitting:
    """One sitting of a training: what has to be kept from step to step."""

    def __init__(self, config: TrainDecoder, folder: Path, training: Training, mark: Mark, measure: Measure) -> None:
        self.config, self.folder, self.training, self.mark, self.measure = config, folder, training, mark, measure
        self.curve = Curve(folder / CURVE, mark.step)
        self.saved = mark.step
        self.recent: list[Mapping[str, float]] = []  # loss terms since the last point for TensorBoard
        self.since_row: list[Mapping[str, float]] = []  # and since the last row of the curve

    def steps(self, log: Events) -> Iterator[int]:
        """Take the steps that are missing, one at a time."""
        while self.training.step < self.config.last_step:
            self.step(log)
            yield self.training.step

    def step(self, log: Events) -> None:
        """One step of the optimiser, and whatever is due after it."""
        begun = time.perf_counter()
        terms = self.training.advance()
        done, config = self.training.step, self.config
        bad = [name for name, value in terms.items() if not math.isfinite(value)]
        if bad and not self.mark.skipped:
            say(f"\nnote: {bad[0]} was not finite in step {done}: the step was skipped, as any further one will be")
        self.mark = dataclasses.replace(
            self.mark,
            step=done,
            seconds=self.mark.seconds + time.perf_counter() - begun,
            bodies=self.mark.bodies + config.batch,
            skipped=self.mark.skipped + bool(bad),
        )
        if not bad:
            self.recent.append(terms)
            self.since_row.append(terms)
        if done % LOG_EVERY == 0:
            log(done, {f"loss/{name}": value for name, value in _means(self.recent).items()})
            self.recent.clear()
        if done % config.evaluate_every == 0 or done == config.last_step:
            figures = dict(self.measure(self.training))
            log(done, {f"held_out/{name}": value for name, value in figures.items() if math.isfinite(value)})
            losses = {f"loss_{name}": value for name, value in _means(self.since_row).items()}
            head = {"step": float(done), "seconds": self.mark.seconds, "bodies": float(self.mark.bodies)}
            self.curve.add({**head, **losses, **figures})
            self.since_row.clear()
        if done % config.checkpoint_every == 0:
            self.save()

    def save(self) -> None:
        """Write a checkpoint of the present step, if there is none of it."""
        if self.saved != self.mark.step:
            write_checkpoint(self.folder, self.training.save, self.mark)
            self.saved = self.mark.step


def _ready(config: TrainDecoder, folder: Path) -> tuple[Training, Mark]:
    """The training as the last sitting left it, or a new one."""
    from decoder import networks
    from decoder.training import Training
    from decoder.weights import SHIPPED, load_weights

    found = read_checkpoint(folder)
    device, machine = _device(config)
    threads = config.threads or cores()
    if found is not None:
        path, then = found
        keep = config.precision in ("auto", then.precision) and device == then.device
        precision = then.precision if keep else _precision(config, device, threads, None)
        mark = dataclasses.replace(then, device=device, precision=precision, threads=threads, machine=machine)
        tell_differences(then, mark)
        training = Training.load(path, _settings(config, device, precision, threads))
        if training.step != then.step:
            raise BadInput(f"{path} is of step {training.step} and its mark says {then.step}; "
                           f"remove {path.parent} to begin again")  # fmt: skip
        return training, mark
    weights = None
    if config.start == "shipped":
        if SHIPPED.exists():
            weights = load_weights(SHIPPED, networks.shapes)
        else:
            say(f"note: {SHIPPED} is not there to go on from, so this training starts from scratch")
    precision = _precision(config, device, threads, weights)
    training = Training.start(_settings(config, device, precision, threads), weights)
    if weights is None:
        return training, Mark(0, 0.0, 0, device, precision, threads, machine, "scratch")
    steps, bodies, seconds = (
        _whole(weights.about.get(key, "")) for key in ("steps", "bodies_seen", "seconds_of_training")
    )
    return training, Mark(
        0, 0.0, 0, device, precision, threads, machine, weights.sha256,
        earlier_steps=steps, earlier_bodies=bodies, earlier_seconds=float(seconds),
    )  # fmt: skip


def _whole(text: str) -> int:
    """A count that weights tell of themselves; 0 if they do not."""
    return int(text) if text.isascii() and text.isdecimal() and len(text) <= 18 else 0


def _device(config: TrainDecoder) -> tuple[str, str]:
    """Where to train, and what that is called."""
    import torch

    if config.device != "cpu" and torch.cuda.is_available():
        return "cuda", str(torch.cuda.get_device_name(0))
    if config.device == "cuda":
        raise BadInput('device = "cuda" and torch finds no GPU; write device = "auto" (see `bodyplan doctor`)')
    threads = config.threads or cores()
    return "cpu", f"{threads} CPU {'thread' if threads == 1 else 'threads'}"


def _precision(config: TrainDecoder, device: str, threads: int, weights: Weights | None) -> str:
    """fp32, or bf16 where it is faster or asked for, and agrees with fp32 on the first batch."""
    from decoder.training import Training, has_bf16

    if config.precision == "fp32" or (config.precision == "auto" and not has_bf16(device)):
        return "fp32"
    fine, coarse = (Training.start(_settings(config, device, name, threads), weights).advance()
                    for name in ("fp32", "bf16"))  # fmt: skip
    name, gap = furthest(fine, coarse)
    told = f"bf16 against fp32 on one batch: {name} differs most, by {100 * gap:.2g} % (bound {100 * BF16_BOUND:g} %)"
    if gap <= BF16_BOUND:
        say(told)
        return "bf16"
    say(f"note: {told}, so this training uses fp32")
    return "fp32"


def furthest(fine: Mapping[str, float], coarse: Mapping[str, float]) -> tuple[str, float]:
    """The loss term on which two precisions differ most, and by how much.

    The difference is relative to the term or, for a small one, to a tenth of the largest; infinite if a term is
    missing or not finite.
    """
    floor = 0.1 * max((abs(value) for value in fine.values()), default=0.0)

    def gap(name: str) -> float:
        a, b = fine[name], coarse.get(name, math.nan)
        if not (math.isfinite(a) and math.isfinite(b)):
            return math.inf
        return abs(a - b) / max(abs(a), floor) if a != b else 0.0

    name = max(fine, key=gap)
    return name, gap(name)


def _settings(config: TrainDecoder, device: str, precision: str, threads: int) -> Settings:
    from decoder.training import Settings

    return Settings(
        seed=config.seed,
        steps=config.steps,
        flow_steps=config.flow_steps,
        batch=config.batch,
        learning_rate=config.learning_rate,
        warmup=config.warmup,
        ema=config.ema,
        start_bodies=config.start_bodies,
        precision=precision,
        device=device,
        threads=threads,
    )


def _means(terms: list[Mapping[str, float]]) -> dict[str, float]:
    """Mean of every term over the steps that have it."""
    names = dict.fromkeys(name for each in terms for name in each)
    return {name: math.fsum(each[name] for each in terms if name in each) / sum(name in each for each in terms)
            for name in names}  # fmt: skip
