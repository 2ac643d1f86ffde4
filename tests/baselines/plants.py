"""Plants of one equation and tests of them, for the baselines."""

import jax
import jax.numpy as jnp
import numpy as np

from hitchid.baselines.baseline import FitContext
from hitchid.structures import Batch


def linear_plant(command, past, gains):
    """Return w(k) = Σ aᵢ w(k−i) + Σ bᵢ u(k−i) from rest, shape [N]."""
    travel = np.zeros(command.size)
    for k in range(command.size):
        for i in range(1, 1 + max(len(past), len(gains))):
            if k >= i:
                travel[k] += past[i - 1] * travel[k - i] if i <= len(past) else 0.0
                travel[k] += gains[i - 1] * command[k - i] if i <= len(gains) else 0.0
    return travel


def batch_of(commands, travels, *, loads=None, until=None, start=0.0, sign=1):
    """Return tests side by side, errors taken up to a sample."""
    width = max(command.size for command in commands)

    def stack(rows):
        return jnp.asarray(np.array([np.pad(row, (0, width - row.size)) for row in rows]))

    counted = [np.arange(command.size) < (until or command.size) for command in commands]
    return Batch(
        command=stack(commands),
        raw_command=stack(commands),
        dead_zone=jnp.zeros(len(commands)),
        displacement=stack([start + sign * travel for travel in travels]),
        valid=stack([np.ones(command.size, dtype=bool) for command in commands]),
        loss_mask=stack(counted),
        initial=jnp.full(len(commands), start),
        covariates=jnp.zeros((len(commands), 0)) if loads is None else jnp.asarray(loads)[:, None],
        step_s=0.01,
        sign=sign,
        covariate_names=() if loads is None else ("pressure",),
    )


def context(seed=0, *, gradient_steps=100):
    """Return the settings of a fit."""
    return FitContext(gradient_steps, jax.random.key(seed))
