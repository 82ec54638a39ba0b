"""What a policy sees is packed one way only, and what it says becomes targets within every bound."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from policies import action_map

from sim.observation import GYRO_SCALE, SPEED_SCALE, ActionMap, ObservationLayout, normaliser


@given(st.integers(1, 15), st.integers(0, 3), st.booleans(), st.integers(0, 2**32 - 1))
def test_unpack_inverts_pack(num_joints: int, batch: int, commanded: bool, seed: int) -> None:
    layout = ObservationLayout(num_joints, commanded=commanded)
    rng = np.random.default_rng(seed)
    lead = (batch,) if batch else ()
    parts = {name: rng.normal(size=(*lead, s.stop - s.start)) for name, s in layout.slices.items()}
    vector = layout.pack(*parts.values())
    assert vector.shape == (*lead, layout.size)
    for name, value in layout.unpack(vector).items():
        np.testing.assert_array_equal(value, parts[name])


def test_slices_tile_the_vector_in_the_stated_order() -> None:
    layout = ObservationLayout(4)
    covered = np.concatenate([np.arange(layout.size)[place] for place in layout.slices.values()])
    np.testing.assert_array_equal(covered, np.arange(18))
    assert list(layout.slices) == ["gravity", "gyro", "position", "velocity", "action"]
    told = ObservationLayout(4, commanded=True)
    assert list(told.slices) == ["gravity", "gyro", "position", "velocity", "action", "command"]
    assert (told.command, told.frame_size) == (slice(18, 21), 21)
    assert layout.command == slice(18, 18)


def test_wrong_sizes_are_refused_by_name() -> None:
    layout = ObservationLayout(2)
    with pytest.raises(ValueError, match=r"'velocity' has shape \(3,\), its last axis must be 2"):
        layout.pack(np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(3), np.zeros(2))
    with pytest.raises(ValueError, match="size 12"):
        layout.unpack(np.zeros(11))
    with pytest.raises(ValueError, match="num_joints >= 1"):
        ObservationLayout(0)
    with pytest.raises(ValueError, match="history >= 1"):
        ObservationLayout(2, 0)


def test_a_command_is_given_if_and_only_if_it_is_taken() -> None:
    parts = (np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(2), np.zeros(2))
    with pytest.raises(ValueError, match="takes no command"):
        ObservationLayout(2).pack(*parts, np.zeros(3))
    told = ObservationLayout(2, commanded=True)
    with pytest.raises(ValueError, match="takes command"):
        told.pack(*parts)
    with pytest.raises(ValueError, match=r"'command' has shape \(2,\)"):
        told.pack(*parts, np.zeros(2))
    np.testing.assert_array_equal(told.pack(*parts, [0.1, 0.2, 0.3])[told.command], [0.1, 0.2, 0.3])


@given(st.integers(1, 5), st.integers(1, 6), st.booleans(), st.integers(0, 2), st.integers(0, 12))
def test_a_history_is_the_latest_frames_the_newest_first(
    num_joints: int, history: int, commanded: bool, batch: int, pushes: int
) -> None:
    layout = ObservationLayout(num_joints, history, commanded)
    lead = (batch,) if batch else ()
    frames = np.random.default_rng(pushes).normal(size=(pushes + 1, *lead, layout.frame_size))
    observation = layout.begin(frames[0])
    for frame in frames[1:]:
        observation = layout.push(observation, frame)
    assert observation.shape == (*lead, layout.size)
    for back in range(history):
        place = slice(back * layout.frame_size, (back + 1) * layout.frame_size)
        np.testing.assert_array_equal(observation[..., place], frames[max(pushes - back, 0)])
    for name, value in layout.unpack(observation).items():
        np.testing.assert_array_equal(value, frames[-1][..., layout.slices[name]])


number = st.floats(-5.0, 5.0)


@given(
    st.lists(st.tuples(number, st.floats(0, 2), number, number, number, st.floats(-50, 50)), min_size=1, max_size=5),
    st.floats(0.01, 1.0), st.floats(0.001, 2.0),
)  # fmt: skip
def test_targets_keep_the_bounds_of_their_map(rows: list[tuple[float, ...]], blend: float, step: float) -> None:
    centre, scale, a, b, previous, said = np.array(rows).T
    low, high = np.minimum(a, b), np.maximum(a, b)
    actions = ActionMap(centre, scale, low, high, blend, step)
    targets = actions.targets(said, previous)
    assert (np.abs(targets - previous) <= step + 1e-9).all()
    # It goes towards what was said, and not beyond.
    wanted = np.clip(centre + scale * np.clip(said, -1, 1), low, high)
    assert (np.abs(wanted - targets) <= np.abs(wanted - previous) + 1e-9).all()
    inside = np.clip(previous, low, high)
    kept = actions.targets(said, inside)
    assert ((kept >= low - 1e-9) & (kept <= high + 1e-9)).all()
    # Whoever says the same for long arrives.
    for _ in range(2000 if step * 2000 > 20 and blend > 0.02 else 0):
        inside = actions.targets(said, inside)
    if step * 2000 > 20 and blend > 0.02:
        np.testing.assert_allclose(inside, wanted, atol=1e-6)


def test_targets_of_many_are_those_of_each() -> None:
    actions = action_map(3, blend=0.5)
    rng = np.random.default_rng(0)
    said, previous = rng.normal(size=(4, 3)), rng.normal(size=(4, 3))
    for row in range(4):
        np.testing.assert_array_equal(actions.targets(said, previous)[row], actions.targets(said[row], previous[row]))
    assert np.isnan(actions.targets([np.nan, 0, 0], np.zeros(3))[0])  # for the guards to see


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scale": np.ones(3)}, r"scale must be \(n,\)"),
        ({"centre": np.zeros(0)}, r"centre must be \(n,\)"),
        ({"low": np.zeros((2, 1))}, r"low must be \(n,\)"),
        ({"high": np.array([0.1, np.inf])}, "high must be finite"),
        ({"centre": np.array([np.nan, 0.0])}, "centre must be finite"),
        ({"low": np.array([0.7, 0.0])}, "low <= high"),
        ({"scale": np.array([-0.1, 0.0])}, "scale >= 0"),
        ({"blend": 0.0}, r"blend must lie in \(0, 1\]"),
        ({"blend": 1.1}, "blend must lie"),
        ({"blend": np.nan}, "blend must lie"),
        ({"step": 0.0}, "step must be finite"),
        ({"step": np.inf}, "step must be finite"),
    ],
)
def test_a_map_refuses_what_is_none(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        action_map(2, **changes)


def test_the_normaliser_makes_ordinary_readings_of_order_one() -> None:
    actions = action_map(2, centre=np.array([0.2, -0.3]), scale=np.array([0.5, 0.01]))
    layout = ObservationLayout(2, history=2, commanded=True)
    centre, gain = normaliser(layout, actions)
    assert centre.shape == gain.shape == (layout.size,)
    frame = layout.pack([0, 0, -1], [GYRO_SCALE, 0, 0], [0.7, -0.3], [0, -SPEED_SCALE], actions.centre, [0.1, 0.0, 0.2])
    normal = layout.unpack((layout.begin(frame) - centre) * gain)
    expected = [[0, 0, -1], [1, 0, 0], [1, 0], [0, -1], [0, 0], [0.1, 0, 0.2]]
    for value, wanted in zip(normal.values(), expected, strict=True):
        np.testing.assert_allclose(value, wanted, atol=1e-12)
    np.testing.assert_array_equal(centre[: layout.frame_size], centre[layout.frame_size :])
    assert (gain > 0).all()
    assert gain.max() <= 10.0  # a joint that may hardly move is not looked at through a microscope
