"""Whatever is commanded, the bench stays within physics."""

import jax
import numpy as np
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from hitchid.bench import load_rig, parameter_sets, simulate
from hitchid.bench.simulation import SUBSTEPS

RIGS = [load_rig(name) for name in parameter_sets()]
SAMPLES = 1001


@settings(suppress_health_check=[HealthCheck.too_slow])
@example(rig=RIGS[0], seed=0, start=0.25, load=3466.0, temperature=0.0)
@given(
    rig=st.sampled_from(RIGS),
    seed=st.integers(0, 2**31),
    start=st.floats(0.0, 0.25),
    load=st.floats(-3000.0, 8000.0),
    temperature=st.floats(-20.0, 100.0),
)
def test_random_commands_stay_within_physics(rig, seed, start, load, temperature):
    rng = np.random.default_rng(seed)
    levels = rng.uniform(0, 3, (4, SAMPLES, 2)) * (rng.random((4, SAMPLES, 2)) < 0.7)
    hold = rng.integers(1, 80, 4)
    currents = np.stack([np.repeat(row, n, axis=0)[:SAMPLES] for row, n in zip(levels, hold, strict=True)])
    motion = simulate(
        rig,
        currents,
        initial_displacement_m=start,
        load_force_n=load * rng.uniform(0, 1, (4, SAMPLES)),
        oil_temperature_c=temperature,
    )
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(motion))
    assert np.all(np.asarray(motion.pressure_pa) > 0)
    assert np.all(np.asarray(motion.supply_pressure_pa) > 0)
    assert np.all(np.asarray(motion.pressure_pa) < 3e7)
    displacement = np.asarray(motion.displacement_m)
    yielded = 2e5 / float(rig.cylinder.stop_stiffness)
    assert displacement.min() > -yielded
    assert displacement.max() < 0.25 + yielded
    # A step is linear: over one in which a check valve closes, flow may run on past zero, by no more than
    # the pump's flow of that step: in a whole test, not each time.
    step_m3 = np.diff(np.asarray(motion.pumped_m3)).max() / SUBSTEPS
    for volume in map(
        np.asarray, (motion.pumped_m3, motion.relieved_m3, motion.lifted_m3, motion.safety_relieved_m3)
    ):
        assert np.all(np.sum(np.maximum(-np.diff(volume, axis=1), 0.0), axis=1) <= step_m3)
