"""Settings of a simulator are found from a robot's response, or it is said why they are not."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from nufleet.orchestrator.study.settings_fit import Setting, SettingsFit, fit_settings
from nufleet.shared.arrays import ComplexArray
from nufleet.shared.errors import RobotError, StudyError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Quality

OMEGA_RAD_S = np.geomspace(0.5, 6.0, 9)
TRUTH = {"stiffness": 11.0, "damping": 3.0, "delay_s": 0.023}
NOISE = 2e-3


def loop(values: Mapping[str, float]) -> ComplexArray:
    s = 1j * OMEGA_RAD_S
    stiffness = values["stiffness"]
    plain = stiffness / (s**2 + values.get("damping", 3.0) * s + stiffness)
    return np.asarray(plain * np.exp(-s * values.get("delay_s", 0.0)))


def played(z: ComplexArray) -> list[FrequencyResponse]:
    variance = np.full(len(z), NOISE**2)
    return [FrequencyResponse(OMEGA_RAD_S, z, variance, 4, Quality())]


def fit(starts: Mapping[str, float], *, crash_above: float = 1e9) -> SettingsFit:
    rng = np.random.default_rng(3)
    noise = NOISE * (rng.standard_normal((2, 9)) * 0.5**0.5 * [[1], [1j]]).sum(axis=0)

    def simulate(values: Mapping[str, float]) -> list[FrequencyResponse]:
        if values["stiffness"] > crash_above:
            raise RobotError("crashed")
        return played(loop(values))

    settings = {name: Setting(start) for name, start in starts.items()}
    return fit_settings(played(loop(TRUTH) + noise), simulate, settings, lambda _k, _most: None)


def test_stiffness_damping_and_a_delay_that_starts_at_zero_are_recovered() -> None:
    found = fit({"stiffness": 8.0, "damping": 4.0, "delay_s": 0.0})
    assert not found.untold
    assert not found.at_bound
    for name, truth in TRUTH.items():
        one = found.settings[name]
        assert abs(one.value - truth) < 4 * one.std
        assert abs(one.value - truth) < 0.05 * truth
    assert found.psi > 0.1
    assert found.psi_left < 4 * NOISE
    assert "agrees best with drone at stiffness" in found.words("drone", "sim")


def test_the_fit_goes_on_where_the_simulator_crashes_on_the_way() -> None:
    found = fit({"stiffness": 8.0, "damping": 4.0, "delay_s": 0.0}, crash_above=11.6)
    assert abs(found.settings["stiffness"].value - 11.0) < 0.5


def test_settings_without_effect_are_named() -> None:
    found = fit({"stiffness": 8.0, "colour": 1.0, "weight": 1.0})
    assert found.untold == ("colour", "weight")
    assert found.settings == {}
    words = "the tests do not tell colour and weight of sim, so nothing is fitted; leave colour and"
    assert words in found.words("drone", "sim")
    assert found.simulations == 4


def test_a_setting_that_loses_its_effect_on_the_way_is_named() -> None:
    def simulate(values: Mapping[str, float]) -> list[FrequencyResponse]:
        return played(loop({"stiffness": min(values["limit"], 9.0)}))

    settings = {"limit": Setting(8.0)}
    found = fit_settings(played(loop(TRUTH)), simulate, settings, lambda _k, _most: None)
    assert found.untold == ("limit",)
    assert found.psi_left == found.psi


def test_settings_that_act_alike_are_named_together() -> None:
    def simulate(values: Mapping[str, float]) -> list[FrequencyResponse]:
        return played(loop({"stiffness": values["gain"] * values["stiffness"]}))

    settings = {"gain": Setting(1.0), "stiffness": Setting(8.0)}
    found = fit_settings(played(loop(TRUTH)), simulate, settings, lambda _k, _most: None)
    assert found.untold == ("gain", "stiffness")
    assert (
        "do not tell gain and stiffness of sim apart, so nothing is fitted; leave one of"
        in found.words("drone", "sim")
    )


def test_a_setting_that_would_have_to_go_further_is_said_to_have_stopped() -> None:
    found = fit({"stiffness": 1.5})
    assert found.at_bound == ("stiffness",)
    assert "stiffness went as far as the fit may go" in found.words("drone", "sim")


def test_robot_and_simulator_need_tones_in_common() -> None:
    other = FrequencyResponse(OMEGA_RAD_S + 0.01, loop(TRUTH), np.full(9, 1e-6), 4, Quality())
    with pytest.raises(StudyError, match="0 tones in common"):
        fit_settings([other], lambda v: played(loop(v)), {"stiffness": Setting(8.0)}, print)
