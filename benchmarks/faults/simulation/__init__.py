"""The whole protocol in one thread: the pure machines of both sides, a virtual clock, a bad network.

What decides in a simulation is the product's own code: `Pursuit`, `Attempts`, `resume`, the lease
rules, `Decisions` and the goal machine, supervisor and ownership in it. What is simulated is what
surrounds them: processes that die and freeze, a network, disks, clocks, and people.
"""
