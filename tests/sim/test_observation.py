import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.observation import ObservationLayout


@given(st.integers(1, 15), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_unpack_inverts_pack(num_joints: int, batch: int, seed: int) -> None:
    layout = ObservationLayout(num_joints)
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


def test_wrong_sizes_are_refused_by_name() -> None:
    layout = ObservationLayout(2)
    with pytest.raises(ValueError, match=r"'velocity' has shape \(3,\), its last axis must be 2"):
        layout.pack(np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(3), np.zeros(2))
    with pytest.raises(ValueError, match="size 12"):
        layout.unpack(np.zeros(11))
    with pytest.raises(ValueError, match="num_joints >= 1"):
        ObservationLayout(0)
