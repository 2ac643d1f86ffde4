"""The linkage against triangles, circles and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np

POSITIONS = np.linspace(0.0, 0.25, 26)


def test_the_cylinder_reaches_from_eye_to_eye(any_rig):
    linkage = any_rig.linkage
    gamma = np.asarray(linkage.sensor_angle(jnp.asarray(POSITIONS))) + float(linkage.sensor_offset)
    eye = float(linkage.cylinder_arm) * np.stack([np.cos(gamma), np.sin(gamma)])
    distance = np.hypot(eye[0] - float(linkage.cylinder_base), eye[1])
    np.testing.assert_allclose(distance, float(linkage.retracted_length) + POSITIONS, rtol=1e-12)


def test_the_lift_rod_keeps_its_length(any_rig):
    linkage = any_rig.linkage
    psi = linkage.arm_angle(jnp.asarray(POSITIONS))
    phi = np.asarray(linkage.link_angle(psi))
    arm = float(linkage.lift_arm) * np.stack([np.cos(psi), np.sin(psi)])
    pivot = np.array([[float(linkage.pivot_x)], [float(linkage.pivot_y)]])
    joint = pivot + float(linkage.rod_joint) * np.stack([np.cos(phi), np.sin(phi)])
    np.testing.assert_allclose(
        np.hypot(*(arm - joint)), np.full(POSITIONS.size, float(linkage.lift_rod)), rtol=1e-12
    )
    assert np.all(joint[1] < arm[1])


def test_displacement_comes_back_from_the_angle(any_rig):
    linkage = any_rig.linkage
    angle = linkage.sensor_angle(jnp.asarray(POSITIONS))
    np.testing.assert_allclose(linkage.displacement(angle), POSITIONS, atol=1e-13)


def test_rates_are_the_slopes_of_angles_and_height(any_rig):
    linkage, step = any_rig.linkage, 1e-6
    upper, lower = jnp.asarray(POSITIONS + step), jnp.asarray(POSITIONS - step)
    rates = linkage.rates(jnp.asarray(POSITIONS))

    def link(x):
        return linkage.link_angle(linkage.arm_angle(x))

    for function, rate in zip((linkage.arm_angle, link, linkage.height), rates, strict=True):
        slope = (np.asarray(function(upper)) - np.asarray(function(lower))) / (2 * step)
        np.testing.assert_allclose(rate, slope, rtol=1e-7)
    np.testing.assert_allclose(
        rates[2], jax.vmap(jax.grad(linkage.height))(jnp.asarray(POSITIONS)), rtol=1e-10
    )


def test_load_slopes_are_finite_differences(any_rig):
    linkage, step = any_rig.linkage, 1e-6
    for position in (0.03, 0.12, 0.22):
        load = linkage.load(jnp.asarray(position))
        above, below = (linkage.load(jnp.asarray(position + sign * step)) for sign in (1, -1))
        for name in ("weight", "mass", "lever"):
            slope = (getattr(above, name) - getattr(below, name)) / (2 * step)
            np.testing.assert_allclose(getattr(load, f"{name}_slope"), slope, rtol=1e-6)


def test_weight_does_the_work_of_raising_the_mass(any_rig):
    """∫ W dx over the stroke is (m_i + m_l/2) g Δh."""
    linkage = any_rig.linkage
    positions = np.linspace(0.0, 0.25, 2001)
    weight, _, _ = linkage.reduced(jnp.asarray(positions))
    rise = float(linkage.height(jnp.asarray(0.25)) - linkage.height(jnp.asarray(0.0)))
    mass = float(linkage.implement_mass + linkage.link_mass / 2)
    np.testing.assert_allclose(np.trapezoid(weight, positions), mass * 9.80665 * rise, rtol=1e-6)
