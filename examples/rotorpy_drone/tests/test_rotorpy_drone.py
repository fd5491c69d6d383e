"""The driver keeps the contract of a robot."""

from nufleet.testing import assert_keeps_contract


def test_the_driver_keeps_the_contract():
    assert_keeps_contract("rotorpy_drone")
