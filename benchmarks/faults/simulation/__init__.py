"""The whole protocol in one thread: both sides' pure machines, a virtual clock, a bad network.

Every decision in a simulation is made by the product's own code: `Pursuit`, `Attempts`, `resume`,
the lease rules, and `Decisions` with its goal machine, supervisor and ownership. Only their
surroundings are simulated: processes that die and freeze, a network, disks, clocks, and people.
"""
