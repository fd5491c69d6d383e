"""One layout for inverse models whose horizons differ, as those of several sources do.

Each source chose its own horizon h. For any h, a `state` model says how fast the reference
should move now, γ + (y(k + h) − u(k − 1))/(hT), and a `preview` how far it should be from the
output, hTγ. So answers of one architecture can be compared and averaged, as γ of one of them, the
leading layout.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.experience.layout import InverseLayout


class CombinedLayout:
    """The inputs of several layouts side by side, and γ of the leading one.

    It takes the place of the `InverseLayout` of a flight, and describes the same sample
    of the flight for all of them.
    """

    def __init__(self, layouts: Sequence[InverseLayout]) -> None:
        """Combine layouts.

        Args:
            layouts: Layouts of the models, the leading one first.

        Raises:
            InvalidInputError: They differ in more than the horizon.
        """
        self.leading = layouts[0]
        for other in layouts:
            alike = other.model_copy(update={"horizon_samples": self.leading.horizon_samples})
            if alike != self.leading:
                raise InvalidInputError(
                    f"inverse models of different inputs: a {self.leading.architecture} of "
                    f"{', '.join(self.leading.states)} at {self.leading.sample_time_s:g} s, and a "
                    f"{other.architecture} of {', '.join(other.states)} at "
                    f"{other.sample_time_s:g} s; choose sources of one architecture"
                )
        self._layouts = tuple(dict.fromkeys(layouts))
        width = len(self.leading.input_names)
        self._columns = {
            layout: slice(i * width, (i + 1) * width) for i, layout in enumerate(self._layouts)
        }
        names = self.leading.input_names
        if self.leading.architecture == "state":
            self._ahead = names.index("output-ahead")
            self._previous = names.index("previous-reference")
        self.states = self.leading.states
        self.measured_states = self.leading.measured_states
        self.back_samples = max(layout.back_samples for layout in self._layouts)
        self.horizon_samples = max(layout.horizon_samples for layout in self._layouts)
        self._before = max(_before(layout) for layout in self._layouts)
        after = max(layout.span_samples - _before(layout) for layout in self._layouts)
        self.span_samples = self._before + after

    @property
    def gp_ease_samples(self) -> int:
        """Number of samples over which a new mean of the online GP takes effect."""
        return self.leading.gp_ease_samples

    @property
    def input_names(self) -> tuple[str, ...]:
        """Name of each input, in order; layouts of different horizons share their names."""
        return self.leading.input_names * len(self._layouts)

    def pairs(self, references: FloatArray, states: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the training pairs (ξ, γ) of a record, as `InverseLayout.pairs` does.

        Args:
            references: References u of one axis in its unit, shape (n,).
            states: States, shape (n, states), each row measured before its reference acted.

        Returns:
            Inputs ξ, shape (m, inputs), and γ of the leading layout in unit/s, shape (m,), with
            m = max(0, n − `span_samples` + 1).
        """
        pairs = max(0, len(references) - self.span_samples + 1)
        found = []
        for layout in self._layouts:
            begin = self._before - _before(layout)
            part = slice(begin, begin + layout.span_samples + pairs - 1 if pairs else begin)
            found.append(layout.pairs(references[part], states[part]))
        return np.concatenate([inputs for inputs, _ in found], axis=1), found[0][1]

    def query(
        self, states: FloatArray, previous: FloatArray, path: FloatArray, velocity: FloatArray
    ) -> FloatArray:
        """Return the inputs ξ at which the models are to be evaluated now.

        Args:
            states: Current states, shape (axes, states).
            previous: Last reference sent, in the axes' unit, shape (axes,).
            path: Desired path from `back_samples` before now to `horizon_samples` ahead, in the
                axes' unit, shape (back + horizon + 1, axes).
            velocity: Velocity of the desired path at the longest horizon, shape (axes,).

        Returns:
            Inputs of each axis, shape (axes, inputs).
        """
        found = []
        for layout in self._layouts:
            end = self.back_samples + layout.horizon_samples
            near = path[self.back_samples - layout.back_samples : end + 1]
            speed = velocity
            if layout.horizon_samples < self.horizon_samples:
                speed = (path[end + 1] - path[end - 1]) / (2 * layout.sample_time_s)
            found.append(layout.query(states, previous, near, speed))
        return np.concatenate(found, axis=1)

    def reference(self, gamma: FloatArray, previous: FloatArray, path: FloatArray) -> FloatArray:
        """Return the reference to send now, shape (axes,), for γ of the leading layout.

        For the arguments see `InverseLayout.reference`; `path` is the same as for `query`.
        """
        now, leading = self.back_samples, self.leading
        near = path[now - leading.back_samples : now + leading.horizon_samples + 1]
        return leading.reference(gamma, previous, near)

    def gp_inputs(self, inputs: FloatArray) -> FloatArray:
        """Return the inputs of the online GP, those of the leading layout, from ξ (m, inputs)."""
        return self.leading.gp_inputs(inputs[:, self._columns[self.leading]])

    def inputs_of(self, layout: InverseLayout, inputs: FloatArray) -> FloatArray:
        """Return the inputs of one of the layouts, shape (m, its inputs), from ξ (m, inputs)."""
        return inputs[:, self._columns[layout]]

    def as_leading(
        self, layout: InverseLayout, inputs: FloatArray, gamma: FloatArray
    ) -> FloatArray:
        """Return what γ of one layout is as γ of the leading layout, shape as γ, in unit/s.

        Args:
            layout: Layout of the model that answered.
            inputs: Inputs ξ, shape (m, inputs).
            gamma: Its γ, in unit/s, shape (…, m).
        """
        if layout == self.leading:
            return gamma
        if layout.architecture == "preview":
            return gamma * (layout.horizon_samples / self.leading.horizon_samples)
        return gamma + self._heading(layout, inputs) - self._heading(self.leading, inputs)

    def _heading(self, layout: InverseLayout, inputs: FloatArray) -> FloatArray:
        """Return (y(k + h) − u(k − 1))/(hT) of a `state` layout, shape (m,), in unit/s."""
        own = self.inputs_of(layout, inputs)
        return np.asarray((own[:, self._ahead] - own[:, self._previous]) / layout.horizon_s)


def _before(layout: InverseLayout) -> int:
    """Return how many samples of a layout's shortest record lie before the sample it describes."""
    if layout.architecture == "state":
        return 1
    # What lies ahead of that sample is the horizon and half of the smoothing window.
    smoothing = (layout.span_samples - layout.back_samples - layout.horizon_samples - 1) // 2
    return layout.back_samples + smoothing
