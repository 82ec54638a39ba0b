"""Episodes are what they say: fair to every copy, the same bytes on any threads, and not stopped by nonsense."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mfg.description import Description
from sim.actor import Gait, smooth_step
from sim.environment import HEAT_TIME, MOST_EXPLOSIONS, PACE_TIME, TEN_SECONDS, Environment, action_map
from sim.herd import with_latency_room
from sim.model import make_spec
from sim.randomisation import RANDOMISED
from sim.rollout import CONTROL_PERIOD, LEAD_IN
from sim.tasks import FAST, Goal, Task
from sim.terrain import Kind, Terrain, lay


@pytest.fixture(scope="module")
def model(quadruped: Description) -> Any:
    return with_latency_room(make_spec(quadruped))


def walked(environment: Environment, seed: int, periods: int = 40) -> np.ndarray:
    """Every observation and reward of random actions."""
    rng = np.random.default_rng(seed)
    found = [environment.reset(np.random.default_rng(seed)).ravel()]
    for _ in range(periods):
        step = environment.step(rng.uniform(-1, 1, (environment.count, environment.model.nu)))
        found += [step.observation.ravel(), step.reward]
    return np.concatenate(found)


def test_the_same_seed_gives_the_same_bytes_on_any_number_of_threads(model: Any) -> None:
    one, two, three = (Environment(model, 5, randomisation=RANDOMISED, nthread=n) for n in (1, 2, 3))
    first = walked(one, 3)
    assert first.tobytes() == walked(two, 3).tobytes() == walked(three, 3).tobytes()
    assert first.tobytes() == walked(one, 3).tobytes()  # and again, in the same environment
    assert first.tobytes() != walked(one, 4).tobytes()


def test_an_episode_ends_by_time_with_its_last_observation(model: Any) -> None:
    environment = Environment(model, 1, episode=replace(TEN_SECONDS, seconds=0.2))
    environment.reset(np.random.default_rng(0))
    ends = [environment.step(np.zeros((1, 4))) for _ in range(10)]
    assert [bool(step.truncated[0]) for step in ends] == [False] * 9 + [True]
    assert ends[-1].lengths.tolist() == [10]
    assert ends[-1].last.shape == (1, environment.layout.size)
    assert not np.array_equal(ends[-1].last[0], ends[-1].observation[0])  # a new episode has begun
    assert ends[-1].returns[0] == pytest.approx(sum(step.reward[0] for step in ends))


def test_a_robot_on_its_back_has_fallen(model: Any) -> None:
    environment = Environment(model, 2)
    environment.reset(np.random.default_rng(0))
    environment.herd.qpos[1, 3:7] = 0.0, 1.0, 0.0, 0.0
    step = environment.step(np.zeros((2, 4)))
    assert step.terminated.tolist() == [False, True]
    assert step.reward[1] == pytest.approx(-0.1 * FAST.fall)


@pytest.mark.parametrize("nonsense", [np.nan, np.inf, -np.inf])
def test_an_action_that_is_no_number_ends_that_copy_alone(model: Any, nonsense: float) -> None:
    sane, mad = Environment(model, 3), Environment(model, 3)
    for environment in (sane, mad):
        environment.reset(np.random.default_rng(1))
    said = np.full((3, 4), 0.3)
    spoilt = said.copy()
    spoilt[1, 2] = nonsense
    good, bad = sane.step(said), mad.step(spoilt)
    assert bad.terminated.tolist() == [False, True, False]
    assert np.isfinite(bad.observation).all()
    np.testing.assert_array_equal(bad.observation[[0, 2]], good.observation[[0, 2]])
    np.testing.assert_array_equal(bad.reward[[0, 2]], good.reward[[0, 2]])


def assert_lags(mean: np.ndarray, value: np.ndarray, time: float) -> None:
    """In twenty periods of an episode and the first of the next, `mean` follows `value` by a first-order lag."""
    share = CONTROL_PERIOD / time
    np.testing.assert_allclose(mean[0], share * value[0])
    np.testing.assert_allclose(mean[1:20], mean[:19] + share * (value[1:20] - mean[:19]))
    np.testing.assert_allclose(mean[20], share * value[20])  # of a new episode


def watched(monkeypatch: pytest.MonkeyPatch, environment: Environment, look: Callable[[Any], Any]) -> Any:
    """Two things that `look` finds in the moment, in twenty periods of an episode and the first of the next."""
    seen: list[Any] = []

    def terms(_: Task, moment: Any) -> dict[str, np.ndarray]:
        seen.append([found.copy() for found in look(moment)])
        return {"speed": np.zeros(2)}

    monkeypatch.setattr("sim.environment.terms", terms)
    environment.reset(np.random.default_rng(0))
    environment._age[:] = environment._born[:] = 0
    for _ in range(21):
        environment.step(np.full((2, 4), 0.5))
    return np.moveaxis(seen, 1, 0)


def test_the_pace_is_the_mean_speed_of_the_last_stride(model: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    environment = Environment(model, 2, episode=replace(TEN_SECONDS, seconds=0.4, start_speed=0.5))
    velocity, pace = watched(monkeypatch, environment, lambda moment: (moment.velocity, moment.pace))
    assert_lags(pace, velocity, PACE_TIME)
    assert np.abs(pace).max() > 0.0


def test_motors_warm_up_by_the_square_of_their_load(model: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    environment = Environment(model, 2, episode=replace(TEN_SECONDS, seconds=0.4))
    herd = environment.herd

    def look(moment: Any) -> Any:
        return np.square(herd.torques / herd.drive.continuous_torque), moment.heat

    load, heat = watched(monkeypatch, environment, look)
    assert_lags(heat, load, HEAT_TIME)
    assert heat.min() >= 0.0
    assert heat.max() > 0.0


def test_physics_that_explodes_is_counted_and_kept_and_the_rest_goes_on(model: Any) -> None:
    environment = Environment(model, 3)
    environment.reset(np.random.default_rng(1))
    environment.herd.qvel[2, 0] = 1e9
    step = environment.step(np.zeros((3, 4)))
    assert step.terminated.tolist() == [False, False, True]
    assert np.isfinite(step.observation).all()
    assert np.isfinite(step.reward).all()
    assert environment.lost == 1
    (explosion,) = environment.explosions
    assert explosion.state[1 + model.nq] == 1e9
    assert explosion.reason
    assert not environment.step(np.zeros((3, 4))).terminated.any()
    for _ in range(MOST_EXPLOSIONS):
        environment.herd.qvel[:, 0] = np.nan
        environment.step(np.zeros((3, 4)))
    assert environment.lost == 1 + 3 * MOST_EXPLOSIONS
    assert len(environment.explosions) == MOST_EXPLOSIONS


def test_an_explosion_is_kept_with_the_robot_it_happened_to(model: Any) -> None:
    environment = Environment(model, 2, randomisation=RANDOMISED)
    environment.reset(np.random.default_rng(1))
    environment.herd.qvel[1, 0] = 1e9
    environment.step(np.full((2, 4), 0.2))
    (explosion,) = environment.explosions
    assert {"latency", "mass", "encoder_offset", "friction"} <= set(explosion.draws)
    assert explosion.draws["mass"].shape == (model.nbody - 1,)
    # The motors read an angle that is off, so they are told another one than the policy wants.
    assert np.abs(explosion.control + explosion.draws["encoder_offset"]).max() < 0.2


@pytest.mark.parametrize("kind", list(Kind))
def test_whoever_is_to_recover_is_dropped_from_its_own_height_on_any_ground(quadruped: Description, kind: Kind) -> None:
    spec = make_spec(quadruped)
    lay(spec, Terrain(kind, seed=1))
    robot = with_latency_room(spec)
    environment = Environment(robot, 4, Task(Goal.RECOVER))
    environment.reset(np.random.default_rng(0))
    assert environment.herd.qpos[:, 2].max() < 1.0


@pytest.mark.parametrize("goal", list(Goal))
def test_every_goal_runs(model: Any, goal: Goal) -> None:
    environment = Environment(model, 4, replace(FAST, goal=goal), randomisation=RANDOMISED)
    found = walked(environment, 0)
    assert np.isfinite(found).all()
    assert environment.layout.commanded == (goal is Goal.COMMAND)


def test_a_history_holds_the_frames_before(model: Any) -> None:
    environment = Environment(model, 2, episode=replace(TEN_SECONDS, history=3))
    environment.reset(np.random.default_rng(0))
    size = environment.layout.frame_size
    before = environment.step(np.full((2, 4), 0.5)).observation
    after = environment.step(np.full((2, 4), -0.5)).observation
    np.testing.assert_array_equal(after[:, size:], before[:, : 2 * size])


def test_a_policy_that_says_nothing_about_a_rhythm_follows_it(model: Any) -> None:
    gait = Gait(1.0, np.full(4, 0.3), np.array([0.0, 1.0, 2.0, 3.0]), np.full(4, 0.1))
    actions = action_map(model, gait.offset)
    environment = Environment(model, 1, actions=actions, rhythm=gait)
    observation = environment.reset(np.random.default_rng(0))
    expected = np.zeros(4)
    for k in range(60):
        before = observation[0, environment.layout.action]
        observation = environment.step(np.zeros((1, 4))).observation
        wanted = before + actions.blend * (gait.targets(k * CONTROL_PERIOD) - before)
        expected = smooth_step(k * CONTROL_PERIOD / LEAD_IN) * wanted  # the pose at rest is 0
        np.testing.assert_allclose(observation[0, environment.layout.action], expected, atol=1e-12)


def test_targets_keep_clear_of_the_stops(model: Any) -> None:
    actions = action_map(model)
    low, high = model.jnt_range[1:].T
    assert (actions.low > low).all()
    assert (actions.high < high).all()
    extreme = actions.targets(np.full((1, 4), 9.0), actions.high[None])
    assert (extreme <= actions.high + 1e-12).all()


def test_what_cannot_be_is_refused_in_words(model: Any) -> None:
    with pytest.raises(ValueError, match="at least one"):
        Environment(model, 0)
    with pytest.raises(ValueError, match="drive 3 joints, the robot has 4"):
        Environment(model, 2, actions=three_of(action_map(model)))


def three_of(actions: Any) -> Any:
    return replace(actions, **{name: getattr(actions, name)[:3] for name in ("centre", "scale", "low", "high")})


def test_actions_of_another_shape_are_refused(model: Any) -> None:
    environment = Environment(model, 2)
    environment.reset(np.random.default_rng(0))
    with pytest.raises(ValueError, match=r"shape \(2, 3\), it must be \(2, 4\)"):
        environment.step(np.zeros((2, 3)))


def test_a_robot_of_five_millimetres_and_one_without_mass(quadruped: Description) -> None:
    """Tiny bodies live or are lost, but nothing hangs; a body without mass is refused by name."""
    shrunk = tuple(
        replace(k, T=k.T / 100, mass=k.mass / 1e6, com=k.com / 100, inertia=k.inertia / 1e10, hull=k.hull / 100)
        for k in quadruped.links
    )
    tiny = with_latency_room(make_spec(replace(quadruped, links=shrunk, standing_height=0.0016)))
    environment = Environment(tiny, 2)
    assert np.isfinite(walked(environment, 0, 20)).all()
    weightless = (*quadruped.links[:2], replace(quadruped.links[2], mass=0.0), *quadruped.links[3:])
    with pytest.raises(ValueError, match="mass"):
        with_latency_room(make_spec(replace(quadruped, links=weightless)))
    with pytest.raises(ValueError, match="no joint"):
        make_spec(replace(quadruped, joints=(), links=quadruped.links[:1]))
