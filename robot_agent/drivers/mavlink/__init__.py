"""PX4 and ArduPilot vehicles over MAVLink: a driver that needs pymavlink (extra `mavlink`)."""
