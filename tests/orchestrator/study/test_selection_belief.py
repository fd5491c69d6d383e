"""Who is the closest, how sure is that, and who is out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nufleet.orchestrator.study.comparison import Compared
from nufleet.orchestrator.study.seen import Seen
from nufleet.orchestrator.study.selection_belief import SelectionBelief, largest
from nufleet.orchestrator.study.trajectory_spectrum import Spectrum
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance

OMEGA = np.array([1.0, 2.0])


def belief(**psi_star: FloatArray) -> SelectionBelief:
    stars = np.stack(list(psi_star.values()))
    psi = np.stack([0.5 * stars, stars], axis=-1)
    return SelectionBelief(tuple(psi_star), OMEGA, psi, psi.mean(axis=1))


def test_distances_are_those_of_responses_drawn_together() -> None:
    target = np.array([[1.0 + 0j, 0.5], [2.0, 1.0]])
    found = SelectionBelief.of(OMEGA, target, {"twin": target, "silent": np.zeros((2, 2), complex)})
    assert found.psi_star[0].tolist() == [0.0, 0.0]
    oracle = [1 / np.sqrt(2), 2 / np.sqrt(5)]  # ψ(z, 0) = |z| / √(1 + |z|²)
    np.testing.assert_allclose(found.psi_star[1], oracle)


def test_the_interval_holds_the_distance_although_what_is_unknown_lengthens_it() -> None:
    """The quantiles alone hold it in 118 of 200, as three tones are independently off."""
    rng, deviation, tones = np.random.default_rng(0), 0.1, 3

    def unknown(count: int) -> ComplexArray:
        shape = (2, count, tones)
        return np.asarray(deviation * (rng.standard_normal(shape).T @ [1, 1j]).T / np.sqrt(2))

    true_z = np.full(tones, 1.4 + 0j)
    true_psi = float(chordal_distance(np.ones(tones), true_z).max())
    held = 0
    for estimate in true_z + unknown(200):
        samples = {"source": estimate + unknown(400)}
        found = SelectionBelief.of(
            np.arange(1.0, tones + 1), np.ones((400, tones), complex), samples
        )
        low, median, high = found.interval("source")
        assert low <= median <= high
        held += low <= true_psi <= high
    assert held >= 0.85 * 200


def test_an_error_that_sources_share_does_not_make_their_order_uncertain() -> None:
    shared = np.random.default_rng(0).normal(0.3, 0.1, 500)
    leader, confidence = belief(near=shared, far=shared + 0.05).leader(0.01, 0.05)
    assert (leader, confidence) == ("near", 1.0)


def test_confidence_is_the_chance_of_being_within_epsilon() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.normal(0.300, 0.01, 20_000), rng.normal(0.305, 0.01, 20_000)
    leader, confidence = belief(first=first, second=second).leader(0.01, 0.05)
    assert leader == "first"
    # P(N(−0.005, √2 · 0.01) < 0.01) = Φ(0.015 / 0.01414)
    assert confidence == pytest.approx(0.8556, abs=0.01)


def test_of_sources_that_are_all_good_enough_the_best_on_average_is_selected() -> None:
    rng = np.random.default_rng(0)
    steady, better = np.full(2000, 0.105), rng.normal(0.1, 0.001, 2000)
    better[:20] = 0.2  # with a probability of 0.01 it is much worse
    sources = belief(steady=steady, better=better)
    assert sources.leader(0.01, 0.05)[0] == "better"
    assert sources.leader(0.01, 0.001)[0] == "steady"


def test_a_source_is_out_only_when_it_is_surely_behind() -> None:
    rng = np.random.default_rng(0)
    samples = {
        "leader": rng.normal(0.1, 0.01, 400),
        "rival": rng.normal(0.12, 0.02, 400),
        "far": rng.normal(0.5, 0.02, 400),
        "unknown": rng.normal(0.5, 0.2, 400),
    }
    out = belief(**samples).hopeless("leader", 0.05)
    assert set(out) == {"far"}
    assert out["far"].startswith("its worst-case distance is 0.399")
    assert out["far"].endswith("leader")


def test_on_a_trajectory_the_best_leaves_the_smallest_error_even_where_another_is_closer() -> None:
    # Three frequencies of the distance, then one of a trajectory, slower than all of them.
    target = np.tile([1.0 + 0j, 0.5, 0.4, 1.0], (5, 1))
    near = np.tile([1.0 + 0j, 0.5, 0.4, 1.2], (5, 1))
    far = np.tile([1.0 + 0j, 0.1, 0.05, 1.01], (5, 1))
    omega = np.array([1.0, 2.0, 3.0])
    slow = Spectrum(np.array([0.2]), np.array([4.0]))
    both = {"near": near, "far": far}
    assert SelectionBelief.of(omega, target, both).leader(0.01, 0.05) == ("near", 1.0)
    found = SelectionBelief.of(omega, target, both, slow)
    assert found.leader(0.01, 0.05) == ("far", 1.0)
    np.testing.assert_allclose(found.loss[:, 0], [0.2 / 1.2, 0.01 / 1.01])
    assert "its predicted error is 0.157" in found.hopeless("far", 0.05)["near"]
    assert found.decisive_omega_rad_s("near") == 0.2
    assert SelectionBelief.of(omega, target, both).decisive_omega_rad_s("far") == 2.0


def test_what_is_not_seen_of_a_source_can_only_make_it_worse() -> None:
    rng = np.random.default_rng(0)
    leader, far = rng.normal(0.1, 0.001, 500), rng.normal(0.3, 0.001, 500)
    # At 1 rad/s each distance is half of that at 2 rad/s.
    sources = belief(leader=leader, far=far)

    def beaten(lowest_rad_s: float) -> tuple[float, dict[str, float]]:
        seen = {"far": sources.part("far", Seen.above(lowest_rad_s))}
        return sources.beaten("leader", 0.01, seen)

    assert sources.beaten("leader", 0.01, {}) == (1.0, {"far": 0.0})
    assert beaten(1.5) == (1.0, {"far": 0.0})
    surely, ahead = beaten(2.5)
    assert surely == 0.0, "nothing was seen of it"
    assert ahead == {"far": 1.0}


def test_near_tones_is_seen_what_lies_next_to_one_of_them_and_not_below_the_lowest() -> None:
    omega_rad_s = np.array([0.5, 0.95, 1.05, 1.5, 2.0, 2.2])
    tones_rad_s = np.array([2.0, 1.0])
    seen = Seen.near(tones_rad_s, 0.1, 1.0).at(omega_rad_s)
    assert seen.tolist() == [False, False, True, False, True, False]
    assert Seen.above(1.05).at(omega_rad_s).tolist() == [False, False, True, True, True, True]


def test_a_source_is_not_beaten_by_what_it_seems_to_do_between_its_tones() -> None:
    """What a model says there counts neither for its distance nor for its error on a path."""
    omega_rad_s = np.array([1.0, 1.5, 2.0])
    target = np.ones((200, 6), complex)
    noise = 0.001 * np.random.default_rng(0).standard_normal((200, 6))
    leader, rival = target + 0.2 + noise, target + noise
    rival[:, [1, 4]] += 1.0
    motion = Spectrum(omega_rad_s, np.ones(3))
    for spectrum in (None, motion):
        count = 3 if spectrum is None else 6
        sources = {"leader": leader[:, :count], "rival": rival[:, :count]}
        found = SelectionBelief.of(omega_rad_s, target[:, :count], sources, spectrum)
        assert found.leader(0.01, 0.05) == ("leader", 1.0)
        assert found.beaten("leader", 0.01, {}) == (1.0, {"rival": 0.0})
        seen = found.part("rival", Seen.near(np.array([1.0, 2.0]), 0.1))
        assert found.beaten("leader", 0.01, {"rival": seen}) == (0.0, {"rival": 1.0})


def test_of_several_axes_each_counts_where_it_was_seen() -> None:
    near, far = np.full((1, 100, 2), 0.1), np.full((1, 100, 2), 0.1)
    far[:, :, 1] = 0.4  # on y, at 2 rad/s
    leader = np.full((1, 100, 2), 0.2)
    x, y = (
        SelectionBelief(("leader", "rival"), OMEGA, psi, psi.mean(axis=1))
        for psi in (np.concatenate([leader, near]), np.concatenate([leader, far]))
    )
    worst = np.maximum(x.psi, y.psi)
    belief = SelectionBelief(("leader", "rival"), OMEGA, worst, worst.mean(axis=1))
    low, high = (Seen.near(np.array([tone_rad_s]), 0.1) for tone_rad_s in OMEGA)
    compared = Compared(belief, {"x": x, "y": y}, {}, ())

    def chance(compared: Compared, **seen: Seen) -> float:
        return compared.beaten("leader", 0.01, {"rival": seen})[1]["rival"]

    assert chance(compared, x=low, y=high) == 0.0
    assert chance(compared, x=high, y=low) == 1.0, "y was not seen where it is far away"
    matrices = replace(compared, coupled=True)
    assert chance(matrices, x=high, y=high) == 0.0
    assert chance(matrices, x=low, y=high) == 1.0, "a matrix is seen where all of its axes are"


def test_a_lead_that_noise_hides_is_settled_by_as_much_less_variance() -> None:
    rng = np.random.default_rng(0)
    noisy = belief(leader=np.full(20_000, 0.4), rival=rng.normal(0.49, 0.1, 20_000))
    # With two sources, P(N(0.09 + 0.01, 0.1 / √times) < 0) = 0.025 at 1.96 deviations.
    assert noisy.variance_to_settle("leader", 0.01, 0.05) == pytest.approx(1.96**2, rel=0.05)
    sure = belief(leader=np.full(200, 0.1), rival=rng.normal(0.5, 0.001, 200))
    assert sure.variance_to_settle("leader", 0.01, 0.05) == 1.0
    behind = belief(leader=rng.normal(0.5, 0.1, 200), rival=np.full(200, 0.1))
    assert behind.variance_to_settle("leader", 0.01, 0.05) == np.inf


def test_a_source_of_which_little_is_known_is_not_held_to_be_far_away() -> None:
    """The unknown moves it away in 99 % of the samples, but it may as well be the closest."""
    rng, shape = np.random.default_rng(0), (4000, 3)
    unknown = 0.3 * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    target, known = np.ones(shape, complex), np.full(shape, 1.2 + 0j)
    found = SelectionBelief.of(
        np.arange(1.0, 4.0), target, {"known": known, "unknown": 1.15 + unknown}
    )
    assert np.mean(found.psi_star[1] > found.psi_star[0]) > 0.8
    assert 0.3 < found.probability_best()[0] < 0.7


def test_the_largest_distance_may_lie_between_the_frequencies() -> None:
    omega_rad_s = np.sort(np.random.default_rng(0).uniform(0.0, 2.0, 30))
    middle = np.linspace(0.5, 1.5, 40)[:, None]
    parabolas = 0.6 - 0.2 * (omega_rad_s - middle) ** 2
    np.testing.assert_allclose(largest(omega_rad_s, parabolas), 0.6, rtol=1e-12)
    rising = np.stack([omega_rad_s / 4, 1.0 - omega_rad_s / 4])
    np.testing.assert_array_equal(largest(omega_rad_s, rising), rising.max(axis=1))
    resonance = 0.5 / np.sqrt(1.0 + ((omega_rad_s - 1.0) / 0.15) ** 2)
    assert abs(largest(omega_rad_s, resonance) - 0.5) < 0.5 * abs(resonance.max() - 0.5)
