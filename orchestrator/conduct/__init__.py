"""A study on a real fleet: leases, tests, stores, retries and resumption."""
