"""For tests of drivers: does a robot keep the contract of `nufleet.Robot`?

>>> assert_keeps_contract("double_integrator", alpha=1.0, beta=0.003)
"""

from __future__ import annotations

from nufleet.robot_agent.driver_kit.check import (
    Examined,
    Report,
    assert_keeps_contract,
    check_robot,
)

__all__ = ["Examined", "Report", "assert_keeps_contract", "check_robot"]
