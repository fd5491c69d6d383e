"""A Crazyflie's side of its protocol over UDP, for flights through cflib without a drone."""
