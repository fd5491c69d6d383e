"""A robot of a closed fleet flies only with what a robot of its fleet has signed and it admits."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from closed_lab import KEYS, ClosedLab, closed_lab
from fleet_lab import Orchestrator
from learned_things import experience
from polling import PATIENCE_S
from robots_that_learn import double_integrator

from nufleet.orchestrator.authority.certificates import (
    certificate_pem,
    read_key,
    utc_now,
)
from nufleet.orchestrator.experience.prior_custody import install
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.orchestrator_id import new_orchestrator_id
from nufleet.robot_agent.agent import Agent
from nufleet.robot_agent.experience_service import ExperienceService
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.network.trust import Trust
from nufleet.shared.errors import NoRouterError, RefusedError
from nufleet.shared.experience.file import (
    Experience,
    decode_experience,
    digest,
    encode_experience,
    signed_content,
    with_signature,
)
from nufleet.shared.experience.signature import UntrustedError, sign
from nufleet.shared.robots.fleet_file import RobotPolicy
from nufleet.shared.wire.identity import Identity, read_identity
from nufleet.shared.wire.messages import ExperienceOffer, InstallRequest, Refusal

ALL = RobotPolicy()
DAY = timedelta(days=1)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> ClosedLab:
    """A fleet whose router is not needed."""
    return ClosedLab(tmp_path_factory.mktemp("signed"), ExitStack())


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> ClosedLab:
    """Another fleet, with robots of the same names."""
    return ClosedLab(tmp_path_factory.mktemp("foreign"), ExitStack())


def identity(lab: ClosedLab, name: str) -> Identity:
    return read_identity(lab.identity(name))


def trust(lab: ClosedLab, name: str, policy: RobotPolicy = ALL, admitted: str = "a.1 b.1") -> Trust:
    return Trust(name, policy, identity(lab, name), lambda: frozenset(admitted.split()))


def signed_by(who: Identity, payload: bytes, at: datetime | None = None) -> bytes:
    signature = sign(
        signed_content(payload), who.key.read_bytes(), who.certificate, at or utc_now()
    )
    return with_signature(payload, signature)


def whose_certificate_ended(lab: ClosedLab, who: Identity) -> Identity:
    """The same identity with a certificate of last week for its key."""
    public = read_key(who.key.read_bytes(), "its key").public_key()
    made = lab.issuer.issue(f"{who.principal}.1", public, utc_now() - 7 * DAY, 3 * DAY)
    return replace(who, certificate=certificate_pem(made))


def dated_back(payload: bytes) -> bytes:
    """The same file with a signature that claims to be a minute older."""
    signature = decode_experience(payload).signature
    assert signature is not None
    earlier = signature.signed_at_s - 60
    return with_signature(payload, signature.model_copy(update={"signed_at_s": earlier}))


def altered(payload: bytes) -> bytes:
    """The same file with one weight changed, and the signature that it had."""
    was = decode_experience(payload)
    arrays = {name: array.copy() for name, array in was.arrays.items()}
    arrays["bias_0"][0] += 1e-6
    assert was.signature is not None
    return with_signature(encode_experience(Experience(was.manifest, arrays)), was.signature)


def renamed(payload: bytes) -> bytes:
    """The same weights and signature under the name of another robot."""
    was = decode_experience(payload)
    manifest = was.manifest.model_copy(update={"robot": "b"})
    assert was.signature is not None
    return with_signature(encode_experience(Experience(manifest, was.arrays)), was.signature)


def test_what_a_robot_of_the_fleet_signed_is_taken_with_its_content_unchanged(
    lab: ClosedLab,
) -> None:
    payload = experience("b")
    signed = trust(lab, "b").signed(payload)
    assert trust(lab, "a").refusal(signed) is None
    assert signed_content(signed) == signed_content(payload)
    assert decode_experience(signed).manifest == decode_experience(payload).manifest
    assert trust(lab, "b").signed(signed) == signed


@pytest.mark.parametrize(
    ("offered", "admitted", "words"),
    [
        (
            lambda lab, other: experience("b"),
            "a.1 b.1",
            "b: it is not signed; start the agent of b",
        ),
        (
            lambda lab, other: altered(signed_by(identity(lab, "b"), experience("b"))),
            "a.1 b.1",
            "b: it was altered after it was signed",
        ),
        (
            lambda lab, other: dated_back(signed_by(identity(lab, "b"), experience("b"))),
            "a.1 b.1",
            "b: it was altered after it was signed",
        ),
        (
            lambda lab, other: renamed(signed_by(identity(lab, "c"), experience("c"))),
            "a.1 b.1 c.1",
            "b: it was altered after it was signed",
        ),
        (
            lambda lab, other: signed_by(identity(lab, "c"), experience("b")),
            "a.1 b.1 c.1",
            "b: it was signed by c",
        ),
        (
            lambda lab, other: signed_by(identity(lab, "desk"), experience("b")),
            "a.1 b.1",
            "b: it was signed by desk",
        ),
        (
            lambda lab, other: signed_by(identity(other, "b"), experience("b")),
            "a.1 b.1",
            "b: it was signed under another authority than this fleet's",
        ),
        (
            lambda lab, other: signed_by(identity(lab, "b"), experience("b")),
            "a.1 b.2",
            "b: b was revoked after it had signed, or is not a robot of the inventory",
        ),
    ],
    ids=[
        "unsigned",
        "altered",
        "dated back",
        "renamed",
        "another's",
        "no robot's",
        "foreign",
        "revoked",
    ],
)
def test_what_is_not_proven_is_refused(
    offered: Callable[[ClosedLab, ClosedLab], bytes],
    admitted: str,
    words: str,
    lab: ClosedLab,
    foreign: ClosedLab,
) -> None:
    refusal = trust(lab, "a", admitted=admitted).refusal(offered(lab, foreign))
    assert refusal is not None
    assert refusal.code == "untrusted"
    assert f"it cannot trust the experience of {words}" in refusal.reason


def test_a_signature_counts_after_its_certificate_has_ended_and_cannot_be_made_then(
    lab: ClosedLab,
) -> None:
    ended, payload = whose_certificate_ended(lab, identity(lab, "b")), experience("b")
    assert trust(lab, "a").refusal(signed_by(ended, payload, utc_now() - 5 * DAY)) is None
    words = "signed on .* with a certificate that is valid from .* to "
    with pytest.raises(UntrustedError, match=words):
        signed_by(ended, payload)
    # A program of its own does not stop there.
    current = decode_experience(signed_by(identity(lab, "b"), payload)).signature
    assert current is not None
    late = current.model_copy(update={"certificate": ended.certificate})
    refusal = trust(lab, "a").refusal(with_signature(payload, late))
    assert refusal is not None
    assert re.search(f"the experience of b: it was {words}", refusal.reason)


def test_a_robot_signs_again_when_its_authority_was_replaced_while_its_agent_ran(
    tmp_path: Path,
) -> None:
    lab = ClosedLab(tmp_path, ExitStack())
    memory, payload = Memory(None), experience("a")
    memory.keep_experience(payload, digest(payload))
    service = ExperienceService("a", double_integrator(), memory, lambda _: None, trust(lab, "a"))
    before = service.offers()
    lab.authority.replace()
    assert service.offers() == before
    lab.authority.renew("a", lab.identity("a").parent)
    (after,) = service.offers()
    assert after.sha256 != before[0].sha256
    assert trust(lab, "b").refusal(memory.experiences[0].payload) is None
    lab.identity("a").write_text("half a fi")
    assert service.offers() == (after,)


def test_a_router_that_does_not_answer_is_no_reason_to_trust(lab: ClosedLab) -> None:
    def silent() -> frozenset[str]:
        raise NoRouterError("the router does not answer")

    signed = signed_by(identity(lab, "b"), experience("b"))
    refusal = Trust("a", ALL, identity(lab, "a"), silent).refusal(signed)
    assert refusal is not None
    assert refusal.reason == "the router does not answer"


@pytest.mark.parametrize("closed", [True, False])
def test_the_fleet_file_of_the_target_decides_whose_priors_it_takes(
    closed: bool, lab: ClosedLab
) -> None:
    signed = trust(lab, "b").signed(experience("b"))
    for robots, taken in (((), False), (("c",), False), (("c", "b"), True)):
        policy = RobotPolicy(priors_from=robots)
        own = Trust("a", policy, None, frozenset)
        refusal = (trust(lab, "a", policy) if closed else own).refusal(signed)
        assert (refusal is None) == taken
        if refusal is not None:
            allowed = ", ".join(robots) or "no robot"
            assert f"take priors from {allowed} (`priors_from` of a), not from b" in refusal.reason


@pytest.mark.parametrize(("robots", "learns"), [(None, True), (("b", "a"), True), (("b",), False)])
def test_a_robot_tries_what_is_trained_from_its_flights_if_its_fleet_file_lets_it_learn(
    robots: tuple[str, ...] | None, learns: bool, lab: ClosedLab
) -> None:
    policy, payload, memory = RobotPolicy(priors_from=robots), experience("a"), Memory(None)
    service = ExperienceService(
        "a", double_integrator(), memory, lambda sender: None, trust(lab, "a", policy)
    )
    request = InstallRequest(sender="desk.1", sha256=digest(payload), payload=payload)
    for install_it in (service.install_prior, service.install_experience):
        answer = install_it(request)
        assert isinstance(answer, ExperienceOffer if learns else Refusal)
    assert (len(memory.priors), len(memory.experiences)) == (int(learns), int(learns))


def test_an_agent_signs_what_it_learned_before_and_gives_up_priors_that_it_may_not_have(
    lab: ClosedLab,
) -> None:
    own, prior = experience("a"), experience("b")
    memory = Memory(None)
    memory.keep_experience(own, digest(own))
    memory.keep_prior(prior, digest(prior))
    service = ExperienceService(
        "a", double_integrator(), memory, lambda sender: None, trust(lab, "a")
    )
    (offer,) = service.offers()
    kept = memory.find(offer.sha256)
    assert kept is not None
    assert trust(lab, "b").refusal(kept.payload) is None
    assert service.priors() == ()


def test_a_revoked_robots_experience_is_refused_from_the_routers_restart_on(
    tmp_path: Path,
) -> None:
    with closed_lab(tmp_path) as lab:
        with ExitStack() as stack:
            desk = served(lab, stack, RobotPolicy(prior_output_max=1e-6))
            learned = install(desk.fleet, "b", "experience", experience("b"))
            assert decode_experience(learned.payload).signature is not None
            assert desk.fleet.describe("b").experiences[0].sha256 == learned.sha256
            with pytest.raises(RefusedError, match=r"cannot trust .*not signed") as raised:
                install(desk.fleet, "a", "prior", experience("b"))
            assert raised.value.code == "untrusted"
            with pytest.raises(RefusedError, match=r"allows 1e-06 \(`prior_output_max`\)"):
                install(desk.fleet, "a", "prior", learned.payload)
            assert desk.fleet.describe("a").prior is None
            held = install(desk.fleet, "c", "prior", learned.payload)
            assert held == learned
            # A robot tries what it is learning as its own prior, before anything is signed.
            install(desk.fleet, "c", "prior", experience("c"))
        lab.authority.revoke("b")
        with ExitStack() as stack:
            desk = served(lab, stack, ALL, "a", "c")
            with pytest.raises(RefusedError, match="b was revoked after it had signed"):
                install(desk.fleet, "a", "prior", learned.payload)
            assert desk.fleet.describe("a").prior is None


def served(
    lab: ClosedLab, stack: ExitStack, policy_of_a: RobotPolicy, *robots: str
) -> Orchestrator:
    """The router and agents, which end with the stack; returns desk."""
    lab.stack = stack
    lab.start_router()
    for name in robots or ("a", "b", "c"):
        policy = policy_of_a if name == "a" else ALL
        agent = Agent(
            lab.session(name), KEYS, name, double_integrator(), realtime=None, policy=policy
        )
        stack.enter_context(agent)
    session = lab.session("desk")
    fleet = Fleet(session, KEYS, new_orchestrator_id(session.principal))
    fleet.wait_for(robots or ("a", "b", "c"), timeout_s=PATIENCE_S)
    return Orchestrator(session, fleet)
