"""For tests of drivers: does a robot keep the contract of `nufleet.Robot`?

>>> from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings
>>> import numpy as np
>>> settings = DoubleIntegratorSettings(alpha=1.0, beta=0.003)
>>> assert_keeps_contract(DoubleIntegrator(settings, np.random.default_rng(0)))
"""

from __future__ import annotations

from nufleet.robot_agent.driver_kit.check import (
    Examined,
    Report,
    assert_keeps_contract,
    check_robot,
)

__all__ = ["Examined", "Report", "assert_keeps_contract", "check_robot"]
