"""Learning an experience from flights, training it, and handing it to another robot."""
