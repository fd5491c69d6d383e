"""What has to be in the environment before any test module is imported."""

from __future__ import annotations

import os

# The simulated quadrotors need SciPy's array interface, which SciPy reads when it is first
# imported; in production their process gets it from its driver's `environment`.
os.environ["SCIPY_ARRAY_API"] = "1"
os.environ["JAX_PLATFORMS"] = "cpu"
