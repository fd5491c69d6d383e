"""Asks a target what it expects of every way to fly a path, with every source's experience.

The experiences are installed on the target for that, since what is rehearsed is what flies; the
priors that it held are put back. Nothing moves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from nufleet.orchestrator.experience.library import ExperienceLibrary
from nufleet.orchestrator.experience.prior_custody import install, prior_put_back
from nufleet.orchestrator.experience.transfer import check_fit
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.labels import BASELINE, MIXTURE, NO_PRIOR, OWN
from nufleet.orchestrator.flights.legs import Leg
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.orchestrator.flights.start_weights import mixture_of
from nufleet.orchestrator.flights.ways import Foresight, WayRecord
from nufleet.shared.errors import InvalidInputError, RefusedError
from nufleet.shared.experience.file import decode_experience
from nufleet.shared.experience.layout import Architecture, InverseLayout
from nufleet.shared.experience.manifest import HORIZON_S, without_experience
from nufleet.shared.wire.messages import Description, ExperienceOffer, ForeseenWay
from nufleet.shared.wire.motions import MIXTURE_MAX

RICH_FLIGHTS_S = (15.0, 30.0, 60.0)
"""Durations of rich flights after which the error with the target's own model is predicted, too."""

OnForeseen = Callable[[int, int], None]
"""Callback that receives the number of ways that are rehearsed, and that of all."""

_PREFERRED: tuple[Architecture, ...] = ("state", "preview")


@dataclass(frozen=True)
class _Asked:
    """A way that the target is asked about."""

    name: str
    own_flight_s: float
    way: ForeseenWay


def foresee(
    fleet: Fleet,
    pilot: Pilot,
    library: ExperienceLibrary,
    target: Description,
    sources: Sequence[str],
    leg: Leg,
    psi: Mapping[str, float] | None = None,
    on_foreseen: OnForeseen = lambda done, total: None,
) -> Foresight:
    """Return what a target expects of a path: alone, with each source, and with all of them.

    Args:
        fleet: Client of the fleet; the target is at rest and leased.
        pilot: Pilot that brings the target to rest if this is interrupted.
        library: Experiences of the fleet's robots; a source without any is named in the result.
        target: Description of the robot that would fly, as it was just received.
        sources: Names of the sources, the most promising ones first.
        leg: Path that would be flown.
        psi: Estimated distance of the sources, from which the mixture's weights start; None to
            start from equal ones.
        on_foreseen: Callback that receives the number of ways that are done, and of all.

    Raises:
        RefusedError, NoReplyError, RobotLostError: The target does not answer, or not now.
    """
    present_s = target.least_known_s
    without: dict[str, str] = {}
    payloads = _payloads(library, target, sources, without)
    if not payloads:
        held: tuple[ExperienceOffer, ...] = ()
        found = _found(fleet, target, held, leg, present_s, psi, on_foreseen)
    else:
        with prior_put_back(fleet, pilot, target):
            installed = 0
            for source, payload in payloads.items():
                try:
                    install(fleet, target.robot, "prior", payload, beside=installed > 0)
                except RefusedError as error:
                    without[source] = error.reason
                else:
                    installed += 1
            held = fleet.describe(target.robot).priors if installed else ()
            found = _found(fleet, target, held, leg, present_s, psi, on_foreseen)
    named = [
        WayRecord(way=source, own_flight_s=present_s, reason=reason)
        for source, reason in without.items()
    ]
    now = [way for way in found if way.own_flight_s <= present_s]
    return Foresight(
        target=target.robot,
        path=leg.title,
        unit=target.spec.axes[0].unit,
        ways=(*now, *named, *found[len(now) :]),
    )


def expected(
    fleet: Fleet,
    target: Description,
    way: ForeseenWay,
    leg: Leg,
    name: str,
    on_foreseen: OnForeseen = lambda done, total: None,
) -> Foresight:
    """Return what a target expects of the baseline and of one other way, with what it holds."""
    present_s = target.least_known_s
    asked = [
        _Asked(BASELINE, present_s, ForeseenWay(inverse="baseline")),
        _Asked(name, present_s, way),
    ]
    return Foresight(
        target=target.robot,
        path=leg.title,
        unit=target.spec.axes[0].unit,
        ways=_answered(fleet, target, asked[name == BASELINE :], leg, on_foreseen),
    )


def _payloads(
    library: ExperienceLibrary,
    target: Description,
    sources: Sequence[str],
    without: dict[str, str],
) -> dict[str, bytes]:
    """Return the sources' experiences that fit, by source; add to `without` why others do not."""
    payloads: dict[str, bytes] = {}
    for source in sources:
        if len(payloads) == MIXTURE_MAX:
            without[source] = f"a target holds and rehearses at most {MIXTURE_MAX} experiences"
            continue
        found = _experience(library, source)
        if found is None:
            without[source] = f"it has learned nothing yet: `nufleet train --robot {source}`"
            continue
        try:
            check_fit(decode_experience(found).manifest, target)
        except InvalidInputError as error:
            without[source] = str(error)
        else:
            payloads[source] = found
    return payloads


def _experience(library: ExperienceLibrary, source: str) -> bytes | None:
    """Return the experience of a source that is fed with the state, else another; None without."""
    for architecture in _PREFERRED:
        try:
            return library.find(source, architecture)[0].read()
        except InvalidInputError:
            continue  # there is none of this architecture
    return None


def _found(
    fleet: Fleet,
    target: Description,
    held: Sequence[ExperienceOffer],
    leg: Leg,
    present_s: float,
    psi: Mapping[str, float] | None,
    on_foreseen: OnForeseen,
) -> tuple[WayRecord, ...]:
    asked = [_Asked(BASELINE, present_s, ForeseenWay(inverse="baseline"))]
    manifests = [prior.manifest for prior in held]
    layout = without_experience(manifests) if manifests else _layout(target)
    if layout is not None:
        way = ForeseenWay(inverse="zero-prior", layout=layout)
        asked.append(_Asked(NO_PRIOR, present_s, way))
    asked.append(_Asked(OWN, present_s, ForeseenWay(inverse="own")))
    for prior in held:
        way = ForeseenWay(inverse="prior", prior_sha256=prior.sha256)
        asked.append(_Asked(prior.manifest.robot, present_s, way))
    if len(held) > 1:
        way = ForeseenWay(inverse="mixture", mixture=mixture_of(held, psi))
        asked.append(_Asked(MIXTURE, present_s, way))
    asked += [
        _Asked(OWN, present_s + more_s, ForeseenWay(inverse="own", after_rich_flight_s=more_s))
        for more_s in RICH_FLIGHTS_S
    ]
    return _answered(fleet, target, asked, leg, on_foreseen)


def _answered(
    fleet: Fleet,
    target: Description,
    asked: Sequence[_Asked],
    leg: Leg,
    on_foreseen: OnForeseen,
) -> tuple[WayRecord, ...]:
    found = fleet.forecast(
        target.robot,
        leg.desired,
        [each.way for each in asked],
        on_foreseen=lambda done: on_foreseen(done, len(asked)),
    )
    return tuple(
        WayRecord.of(each.name, each.own_flight_s, one)
        for each, one in zip(asked, found, strict=True)
    )


def _layout(target: Description) -> InverseLayout | None:
    """Return the layout of learning from nothing; None for a robot that measures no states."""
    if not target.state_names:
        return None
    return InverseLayout(
        architecture="state",
        states=target.state_names,
        sample_time_s=target.spec.sample_time_s,
        horizon_samples=max(1, round(HORIZON_S / target.spec.sample_time_s)),
    )
