"""The chordal distance is the metric of the Riemann sphere, and its uncertainty covers."""

from __future__ import annotations

import cmath
import math

import mpmath  # type: ignore[import-untyped]
import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from nufleet.shared.arrays import ComplexArray
from nufleet.shared.distance.chordal import (
    chordal_distance,
    chordal_variance,
    geodesic_radius,
    matrix_chordal_distance,
    riemann_sphere,
    worst_case_chordal_distance,
)
from nufleet.shared.distance.graph_angles import sines
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.models.linear_model import LinearModel
from nufleet.sims.double_integrator import DoubleIntegratorSettings, closed_loop

magnitudes = st.one_of(st.floats(0.0, 1e3), st.floats(-308, 308).map(lambda e: 10.0**e))
angles = st.floats(-math.pi, math.pi)
responses = st.builds(cmath.rect, magnitudes, angles)
moderate = st.builds(cmath.rect, st.floats(0.0, 20.0), angles)
extended = st.one_of(responses, st.just(complex(math.inf, 0)), st.just(complex(-1.0, math.inf)))


def array(*values: complex) -> ComplexArray:
    return np.array(values, dtype=np.complex128)


def psi(z_1: complex, z_2: complex) -> float:
    return float(chordal_distance(array(z_1), array(z_2))[0])


def exact_psi(z_1: complex, z_2: complex) -> float:
    """The paper's eq. (4) in 60 digits, however large the numbers are."""
    with mpmath.workdps(60):
        a, b = mpmath.mpc(z_1), mpmath.mpc(z_2)
        distance = abs(a - b) / mpmath.sqrt((1 + abs(a) ** 2) * (1 + abs(b) ** 2))
        return float(distance)


@settings(deadline=None)
@given(responses, responses)
def test_it_is_the_papers_equation_four_for_numbers_of_any_size(z_1: complex, z_2: complex) -> None:
    assert psi(z_1, z_2) == pytest.approx(exact_psi(z_1, z_2), rel=1e-14, abs=1e-149)


@settings(deadline=None)
@given(extended, extended, extended)
def test_it_is_a_metric_bounded_by_one(z_1: complex, z_2: complex, z_3: complex) -> None:
    assert psi(z_1, z_1) == 0.0
    assert psi(z_1, z_2) == psi(z_2, z_1)
    assert 0.0 <= psi(z_1, z_2) <= 1.0
    assert psi(z_1, z_3) <= psi(z_1, z_2) + psi(z_2, z_3) + 1e-15


@settings(deadline=None)
@given(moderate, moderate)
def test_different_responses_are_apart(z_1: complex, z_2: complex) -> None:
    assume(z_1 != z_2)
    assert psi(z_1, z_2) > 0.0


@settings(deadline=None)
@given(responses, responses, angles)
def test_inversion_and_rotation_keep_distances(z_1: complex, z_2: complex, angle: float) -> None:
    assume(min(abs(z_1), abs(z_2)) > 1e-300)
    turn = cmath.rect(1.0, angle)
    expected = pytest.approx(psi(z_1, z_2), abs=1e-14)
    assert psi(1 / z_1, 1 / z_2) == expected
    assert psi(turn * z_1, turn * z_2) == expected


@settings(deadline=None)
@given(extended, extended)
def test_it_is_the_euclidean_distance_between_projections(z_1: complex, z_2: complex) -> None:
    points = riemann_sphere(array(z_1, z_2))
    assert np.linalg.norm(points[0] - points[1]) == pytest.approx(psi(z_1, z_2), abs=1e-15)


@settings(deadline=None)
@given(extended)
def test_projections_lie_on_the_sphere_of_radius_one_half_that_touches_the_plane_at_zero(
    z: complex,
) -> None:
    point = riemann_sphere(array(z))[0]
    assert np.linalg.norm(point - [0.0, 0.0, 0.5]) == pytest.approx(0.5, abs=1e-15)


@settings(deadline=None)
@given(moderate)
def test_a_projection_lies_on_the_line_from_the_north_pole_to_its_point(z: complex) -> None:
    point = riemann_sphere(array(z))[0]
    north, plane = np.array([0.0, 0.0, 1.0]), np.array([z.real, z.imag, 0.0])
    np.testing.assert_allclose(np.cross(point - north, plane - north), 0.0, atol=1e-14)


def test_poles_and_antipodes_are_where_they_should_be() -> None:
    infinity = complex(math.inf, math.inf)
    np.testing.assert_array_equal(riemann_sphere(array(0, infinity)), [[0, 0, 0], [0, 0, 1]])
    assert psi(0, infinity) == 1.0
    assert psi(infinity, complex(0, -math.inf)) == 0.0
    assert psi(3 + 4j, infinity) == pytest.approx(1 / math.sqrt(26), rel=1e-15)
    assert psi(3 + 4j, -1 / (3 - 4j)) == pytest.approx(1.0, abs=1e-15)


def test_distances_broadcast_and_keep_shapes() -> None:
    targets, sources = np.ones((1, 5), complex), np.full((3, 1), 1j)
    assert chordal_distance(targets, sources).shape == (3, 5)
    assert riemann_sphere(np.zeros((3, 5), complex)).shape == (3, 5, 3)


@settings(deadline=None)
@given(moderate, st.floats(0.0, 60.0), angles, st.floats(0.0, 1.0))
def test_no_point_of_a_disc_is_further_on_the_sphere_than_its_geodesic_radius(
    centre: complex, radius: float, angle: float, share: float
) -> None:
    inside = centre + cmath.rect(share * radius, angle)
    reach = float(geodesic_radius(array(centre), np.array([radius]))[0])
    assert math.asin(psi(centre, inside)) <= reach + 1e-7


@settings(deadline=None)
@given(moderate.filter(lambda z: abs(z) > 1e-3), st.floats(0.0, 60.0))
def test_a_geodesic_radius_is_reached_by_some_point_of_the_disc(
    centre: complex, radius: float
) -> None:
    reach = float(geodesic_radius(array(centre), np.array([radius]))[0])
    inward = -centre / abs(centre)
    line = array(*(centre + radius * inward * np.linspace(0.0, 1.0, 2001)))
    furthest = float(np.max(chordal_distance(array(centre), line)))
    assert math.sin(reach) == pytest.approx(furthest, abs=2e-3)
    assert furthest <= math.sin(reach) + 1e-12


@pytest.mark.parametrize(
    ("z_1", "z_2", "sigma_1", "sigma_2"),
    [(1.0, 0.5 - 0.5j, 0.01, 0.02), (2j, 1.5 + 0.2j, 0.03, 0.0), (5.0, -0.2, 0.01, 0.002)],
)
def test_the_variance_of_a_distance_is_that_of_a_simulation(
    z_1: complex, z_2: complex, sigma_1: float, sigma_2: float
) -> None:
    rng = np.random.default_rng(7)
    draws = 200_000
    noise = (rng.standard_normal((2, draws)) + 1j * rng.standard_normal((2, draws))) / math.sqrt(2)
    simulated = np.var(chordal_distance(z_1 + sigma_1 * noise[0], z_2 + sigma_2 * noise[1]))
    predicted = chordal_variance(
        array(z_1), np.array([sigma_1**2]), array(z_2), np.array([sigma_2**2])
    )
    # Where ψ is near 1 only second-order terms are left, so the absolute error counts there.
    assert predicted[0] == pytest.approx(simulated, rel=0.02, abs=1e-7)


SECTION_V = [((1.0, 0.003), 0.0694, 4.5), ((0.97, 0.004), 0.0212, 4.0), ((0.9, 0.001), 0.0918, 4.5)]


def section_v(alpha: float, beta: float) -> LinearModel:
    return closed_loop(DoubleIntegratorSettings(alpha=alpha, beta=beta))


@pytest.mark.parametrize(("source", "expected", "at"), SECTION_V)
def test_the_worst_case_of_the_papers_fleet_is_the_closed_form(
    source: tuple[float, float], expected: float, at: float
) -> None:
    found, omega = worst_case_chordal_distance(
        section_v(*source), section_v(0.85, 0.003), (0.0, 10.0)
    )
    assert found == pytest.approx(expected, abs=5e-5)
    assert omega == pytest.approx(at, abs=0.05)


def resonator(omega_rad_s: float, damping: float) -> LinearModel:
    """A sampled second-order loop of unit gain at low frequency."""
    step_s = 0.01
    pole = cmath.exp(complex(-damping, math.sqrt(1 - damping**2)) * omega_rad_s * step_s)
    a_1, a_0 = -2 * pole.real, abs(pole) ** 2
    return LinearModel(
        a=((0.0, 1.0), (-a_0, -a_1)), b=(0.0, 1.0), c=(1 + a_1 + a_0, 0.0), sample_time_s=step_s
    )


@example(29.87890625, 0.890625, 10.0**-4.75, 1e-4)  # the peak is far out on a resonance's flank
@settings(max_examples=25, deadline=None)
@given(
    st.floats(0.5, 40.0),
    st.floats(0.5, 40.0),
    st.floats(-5.0, -0.1).map(lambda e: 10.0**e),
    st.floats(-5.0, -0.1).map(lambda e: 10.0**e),
)
def test_no_frequency_of_a_much_finer_search_is_worse(
    omega_1: float, omega_2: float, damping_1: float, damping_2: float
) -> None:
    model_1, model_2 = resonator(omega_1, damping_1), resonator(omega_2, damping_2)
    found, at = worst_case_chordal_distance(model_1, model_2, (0.1, 50.0))
    near = np.concatenate(
        [
            np.linspace(0.1, 50.0, 5000),
            *(
                omega * (1 + damping * np.linspace(-10, 10, 2001))
                for omega, damping in ((omega_1, damping_1), (omega_2, damping_2))
            ),
            *(
                omega + sign * omega * damping * np.geomspace(1, 1e5, 4001)
                for omega, damping in ((omega_1, damping_1), (omega_2, damping_2))
                for sign in (-1, 1)
            ),
            at + 1e-5 * np.linspace(-1, 1, 101),
        ]
    )
    near = near[(near >= 0.1) & (near <= 50.0)]
    searched = chordal_distance(model_1.frequency_response(near), model_2.frequency_response(near))
    assert searched.max() <= found + 1e-9
    reached = chordal_distance(
        model_1.frequency_response(np.array([at])), model_2.frequency_response(np.array([at]))
    )
    assert found == pytest.approx(float(reached[0]), abs=1e-12)


def test_a_model_is_no_distance_from_itself() -> None:
    model = section_v(0.85, 0.003)
    assert worst_case_chordal_distance(model, model, (0.05, 10.0))[0] == 0.0


@pytest.mark.parametrize("band", [(1.0, 1.0), (-1.0, 2.0), (2.0, 1.0), (0.1, math.pi / 0.015)])
def test_a_band_that_is_empty_or_reaches_nyquist_is_refused(band: tuple[float, float]) -> None:
    model = section_v(0.85, 0.003)
    with pytest.raises(InvalidInputError, match="Nyquist"):
        worst_case_chordal_distance(model, model, band)


def test_the_distance_of_matrices_is_that_of_their_graphs_and_of_numbers_the_chordal_one() -> None:
    rng = np.random.default_rng(0)
    z_1, z_2 = rng.standard_normal((2, 40, 3, 2)) + 1j * rng.standard_normal((2, 40, 3, 2))
    identity = np.broadcast_to(np.eye(2), (40, 2, 2))
    graphs = [np.concatenate([identity, z], axis=1) for z in (z_1, z_2)]
    np.testing.assert_allclose(matrix_chordal_distance(z_1, z_2), sines(*graphs)[:, 0])
    numbers = z_1[:, :1, :1], z_2[:, :1, :1]
    expected = chordal_distance(*numbers)[:, 0, 0]
    np.testing.assert_allclose(matrix_chordal_distance(*numbers), expected)
    np.testing.assert_allclose(matrix_chordal_distance(z_1, z_1), 0.0, atol=1e-15)
