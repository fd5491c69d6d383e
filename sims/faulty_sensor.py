"""A sensor that fails in one of the ways of `nufleet.sims.faults`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nufleet.shared.arrays import FloatArray
from nufleet.sims import faults
from nufleet.sims.faults import SensorFault

BoolArray = NDArray[np.bool_]


class FaultySensor:
    """Applies one sensor fault to a robot's measurements, motion after motion."""

    def __init__(self, fault: SensorFault, sample_time_s: float, rng: np.random.Generator) -> None:
        self._fault = fault
        self._sample_time_s = sample_time_s
        # Separate generators for separate quantities, so that a batch draws the same numbers as
        # its samples would one by one.
        self._chances, self._values = rng.spawn(2)
        self._motion, self._sample = 0, 0
        self._past = np.empty((0, 0))
        self._stuck = np.empty(0)
        self._hold_left = np.empty(0, dtype=np.int64)

    def begin_motion(self) -> None:
        """Begin a motion, of which the next sample is the first."""
        self._motion += 1
        self._sample = 0
        self._past = np.empty((0, 0))

    def measured(self, outputs: FloatArray) -> FloatArray:
        """Return the faulty sensor's readings of the next outputs, shape (samples, axes)."""
        if not len(outputs):
            return outputs
        count, axes = outputs.shape
        if self._past.shape[1] != axes:
            self._past = np.repeat(outputs[:1], _memory(self._fault), axis=0)
            self._hold_left = np.zeros(axes, dtype=np.int64)
        acts = self._fault.acts(self._motion, self._sample, count, self._sample_time_s)
        known = np.concatenate([self._past, outputs])
        changed = self._changed(outputs, known, acts)
        # A sensor that holds or freezes repeats its own readings, a late one true past outputs.
        remembered = (
            known if isinstance(self._fault, faults.Late) else np.concatenate([self._past, changed])
        )
        self._past = remembered[len(remembered) - len(self._past) :]
        self._sample += count
        return changed

    def _changed(self, outputs: FloatArray, known: FloatArray, acts: BoolArray) -> FloatArray:
        fault, where = self._fault, acts[:, np.newaxis]
        # Every kind draws for every sample, acting or not, so that the draws depend on time alone.
        chance = self._chances.random(outputs.shape)
        match fault:
            case faults.NotANumber(probability=probability):
                return np.where(where & (chance < probability), np.nan, outputs)
            case faults.Infinite(probability=probability):
                sign = np.where(self._values.random(outputs.shape) < 0.5, -np.inf, np.inf)
                return np.where(where & (chance < probability), sign, outputs)
            case faults.Saturated(low=low, high=high):
                return np.where(where, np.clip(outputs, low, high), outputs)
            case faults.Noisy(std=std):
                noise = std * self._values.standard_normal(outputs.shape)
                return np.where(where, outputs + noise, outputs)
            case faults.Spikes(probability=probability, height=height, replace=replace):
                sign = np.where(self._values.random(outputs.shape) < 0.5, -1.0, 1.0)
                spike = np.full_like(outputs, height) if replace else outputs + sign * height
                return np.where(where & (chance < probability), spike, outputs)
            case faults.Late(late_min=least, late_max=most):
                late = least + np.floor(chance * (most - least + 1)).astype(np.int64)
                rows = len(self._past) + np.arange(len(outputs))[:, np.newaxis] - late
                return np.where(where, np.take_along_axis(known, rows, axis=0), outputs)
            case faults.Frozen(noise=std):
                noise = std * self._values.standard_normal(outputs.shape)
                return self._frozen(outputs, acts) + np.where(where, noise, 0.0)
            case faults.Held(probability=probability, run=run):
                return self._held(outputs, where & (chance < probability), run)

    def _frozen(self, outputs: FloatArray, acts: BoolArray) -> FloatArray:
        frozen = outputs.copy()
        if acts.any():
            begins = int(np.argmax(acts))
            last = self._past[-1] if begins == 0 else outputs[begins - 1]
            if self._sample + begins == self._fault.first_sample(self._sample_time_s):
                self._stuck = last.copy()
            frozen[acts] = self._stuck
        return frozen

    def _held(self, outputs: FloatArray, begins: BoolArray, run: int) -> FloatArray:
        held = outputs.copy()
        last = self._past[-1].copy()
        for k in range(len(outputs)):
            self._hold_left[begins[k] & (self._hold_left == 0)] = run
            missing = self._hold_left > 0
            held[k, missing] = last[missing]
            last = held[k].copy()
            self._hold_left[missing] -= 1
        return held


def _memory(fault: SensorFault) -> int:
    """Return the number of past samples that a fault reads."""
    return max(1, fault.late_max) if isinstance(fault, faults.Late) else 1
