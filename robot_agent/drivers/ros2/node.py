"""The node that speaks for one robot; the only module that needs ROS 2."""

from __future__ import annotations

import logging
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from typing import Any

from nufleet.robot_agent.drivers.ros2.calls import first_answer, keep_turning
from nufleet.robot_agent.drivers.ros2.clocks import Arrivals
from nufleet.robot_agent.drivers.ros2.graph import (
    SERVICE_TYPES,
    Endpoint,
    reading_problem,
    service_problem,
    writing_problem,
)
from nufleet.robot_agent.drivers.ros2.link import Link
from nufleet.robot_agent.drivers.ros2.messages import Battery, SetPoint, measured, message_of
from nufleet.robot_agent.drivers.ros2.settings import TF, Qos, Ros2Settings
from nufleet.shared.errors import RobotError

_log = logging.getLogger(__name__)

NO_ROS = (
    "ROS 2 cannot be imported ({error}): run `source /opt/ros/DISTRO/setup.bash` in the shell that "
    "starts the agent, with Python of the same version, or install the wheels of `make test-ros2`"
)

FOUND_WITHIN_S = 10.0
"""Time in which topics and services have to be found as they should be."""

SETTLED_S = 1.0
"""Time for which all has to be well: a second publisher may be found later than the first."""

FIRST_WITHIN_S = 3.0
"""Time in which the first measurement has to come."""

SPIN_S = 0.1
"""Longest time for which the node's thread waits for a message before it looks whether to end."""

QUEUED_MAX_S = 10.0
"""Longest time for which a message that the middleware has received waits for the node's thread."""

STANDSTILL_MAX_S = 2.0
"""Longest time for which the clock of a simulation may stand still."""

CLOCK_STEP_MAX = 0.5
"""Largest step of a simulation's clock, as a share of the sample time."""

BATTERY = "sensor_msgs/msg/BatteryState"

NS_PER_S = 1_000_000_000


class RosNode(Link):
    """A node in a context of its own, with a thread that receives and repeats set-points."""

    def __init__(self, name: str, settings: Ros2Settings) -> None:
        """Reach the robot.

        Args:
            name: Name of the robot.
            settings: Settings of the robot.

        Raises:
            RobotError: ROS 2, a topic, a service or a measurement is missing or wrong.
        """
        self._settings = settings
        self._failure: str | None = None
        self._closed = False
        topic = "" if settings.battery is None else settings.full(settings.battery.topic)
        self._battery = Battery(topic, time.monotonic())
        self._resend: Callable[[], None] | None = None
        self._sent_s = 0.0
        self.arrivals = Arrivals(
            settings.full(settings.measurement.topic),
            settings.measured,
            "simulated" if settings.use_sim_time else settings.measurement.stamps,
        )
        with ExitStack() as opened:
            self._open(name, opened)
            self._await_graph()
            self._await_clock()
            self.arrivals.next(FIRST_WITHIN_S)
            self.arrivals.next(FIRST_WITHIN_S)  # a stamp that repeats or goes back shows here
            while settings.battery is not None and self.charge() is None:
                time.sleep(0.05)
            self._opened = opened.pop_all()

    def now_s(self) -> float:
        """Return the time on the monotonic clock, or the time of the simulation."""
        if self._settings.use_sim_time:
            return float(self._node.get_clock().now().nanoseconds) / NS_PER_S
        return time.monotonic()

    def wait_until(self, due_s: float) -> None:
        """Wait until a time; raises RobotError when the simulation's clock stands still."""
        if not self._settings.use_sim_time:
            time.sleep(max(0.0, due_s - time.monotonic()))
            return
        last_s, moved_s = self.now_s(), time.monotonic()
        while (now_s := self.now_s()) < due_s:
            if now_s > last_s:
                last_s, moved_s = now_s, time.monotonic()
            elif time.monotonic() - moved_s > STANDSTILL_MAX_S:
                raise RobotError("the simulation's clock stands still: nothing comes on /clock")
            time.sleep(0.0005)

    def send(self, point: SetPoint) -> float:
        """Publish a set-point now, and return when."""
        now_ns = self._node.get_clock().now().nanoseconds
        command, sample_time_s = self._settings.command, self._settings.sample_time_s
        message = message_of(point, command, now_ns, sample_time_s, _new)
        self._sent_s = self.now_s()
        self._publisher.publish(message)
        return self._sent_s

    def keep_sending(self, resend: Callable[[], None] | None) -> None:
        """Call a function whenever one and a half samples pass without a set-point; None stops."""
        self._resend = resend

    def call(self, role: str, engage: bool, timeout_s: float, requests: int = 1) -> None:
        """Call a service and wait for its answer, on any thread but the node's own."""
        client, name, takes_data = self._clients[role]
        request = client.srv_type.Request()
        if takes_data:
            request.data = engage
        answer = first_answer(client, request, timeout_s, requests)
        if answer is None:
            raise RobotError(f"the service {name} has not answered for {timeout_s:.2g} s")
        if not answer.success:
            raise RobotError(f"the service {name} refused: {answer.message or 'it gave no reason'}")

    def charge(self) -> float | None:
        """Return the newest charge; raises RobotError also where the node's thread has failed."""
        if self._failure is not None:
            raise RobotError(self._failure)
        return None if self._settings.battery is None else self._battery.charge(time.monotonic())

    def close(self) -> None:
        """Leave ROS 2; a second call does nothing."""
        self._closed = True
        self._opened.close()

    def _open(self, name: str, opened: ExitStack) -> None:
        with _ros():
            import rclpy
            from rclpy.context import Context
            from rclpy.executors import SingleThreadedExecutor
            from rclpy.node import Node
            from rclpy.parameter import Parameter
            from rclpy.signals import SignalHandlerOptions
        settings, context = self._settings, Context()
        rclpy.init(
            args=[],
            context=context,
            domain_id=settings.domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        opened.callback(context.try_shutdown)
        node = Node(
            # Unique, to be told from another agent's.
            f"nufleet_{name.replace('-', '_')}_{secrets.token_hex(4)}",
            context=context,
            namespace=settings.namespace or "/",
            parameter_overrides=[Parameter("use_sim_time", value=settings.use_sim_time)],
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._node = node
        opened.callback(node.destroy_node)
        command, reading, battery = settings.command, settings.measurement, settings.battery
        self._publisher = node.create_publisher(
            _type(command.type), settings.full(command.topic), _profile(command.qos)
        )
        node.create_subscription(
            _type(reading.type),
            settings.full(reading.topic),
            self._received,
            _profile(reading.qos),
        )
        if battery is not None:
            node.create_subscription(
                _type(BATTERY),
                settings.full(battery.topic),
                lambda message: self._battery.take(message, time.monotonic()),
                _profile(Qos(reliability="best_effort", depth=1)),
            )
        from rclpy.clock import Clock, ClockType

        node.create_timer(
            settings.sample_time_s / 2, self._repeat, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)

        closing = threading.Event()

        def spin() -> None:  # the executor is shut down only after its last turn
            keep_turning(lambda: executor.spin_once(timeout_sec=SPIN_S), closing, self._failed)

        opened.callback(executor.shutdown)
        thread = threading.Thread(target=spin, name=f"{name}-ros2", daemon=True)
        thread.start()
        opened.callback(thread.join)
        opened.callback(closing.set)

    def _received(self, message: Any, info: Any) -> None:
        """Take a measurement, on the node's thread."""
        said = measured(message, self._settings.measurement)
        if said is None:
            return
        if self._settings.use_sim_time:
            if (simulated_s := self.now_s()) > 0:  # /clock has come, too
                self.arrivals.take(said.stamp_s, simulated_s, said.values)
            return
        now_s, now_ns = time.monotonic(), time.time_ns()
        # The middleware has received it a little earlier; some of them do not say when.
        waited_s = (now_ns - info["received_timestamp"]) / NS_PER_S
        arrived_s = now_s - waited_s if 0 <= waited_s < QUEUED_MAX_S else now_s
        stamp_s = said.stamp_s
        if stamp_s is not None and self._settings.measurement.stamps == "synchronised":
            stamp_s += now_s - now_ns / NS_PER_S
        self.arrivals.take(stamp_s, arrived_s, said.values)

    def _failed(self, error: Exception) -> None:
        """Have every later report of health say what failed; the log says where, once."""
        failure = f"a message of ROS 2 could not be handled ({error!r}): see the agent's log"
        if failure != self._failure:
            _log.error("%s", failure, exc_info=error)
        self._failure = failure

    def _repeat(self) -> None:
        resend = self._resend
        if resend is not None and self.now_s() - self._sent_s > 1.5 * self._settings.sample_time_s:
            with suppress(RobotError):  # its motors were cut just now, as every other call says
                resend()

    def _await_graph(self) -> None:
        """Wait until all topics and services are as they should be, and have been for a while."""
        begun_s = well_s = time.monotonic()
        while time.monotonic() - well_s < SETTLED_S:
            problem = self.problem()
            if problem is not None:
                well_s = time.monotonic()
                if well_s - begun_s > FOUND_WITHIN_S:
                    raise RobotError(problem)
            time.sleep(0.1)
        kinds = dict(self._node.get_service_names_and_types())
        self._clients: dict[str, tuple[Any, str, bool]] = {}
        for role, short in self._settings.services.named.items():
            name = self._settings.full(short)
            kind = next(one for one in kinds[name] if one in SERVICE_TYPES)
            client = self._node.create_client(_type(kind), name)
            if not client.wait_for_service(FIRST_WITHIN_S):
                raise RobotError(f"the service {name} is listed, and does not take requests")
            self._clients[role] = (client, name, kind == SERVICE_TYPES[1])

    def problem(self) -> str | None:
        """Return what is wrong with topics and services now; None if nothing is."""
        try:
            problem = self._problem()
            domain = self._node.context.get_domain_id()
        except Exception:
            if self._closed:  # by another thread, just now
                return "it has been disconnected"
            raise
        return None if problem is None else f"{problem} (ROS domain {domain})"

    def _problem(self) -> str | None:
        node, settings = self._node, self._settings
        topics = dict(node.get_topic_names_and_types())
        command, reading, battery = settings.command, settings.measurement, settings.battery
        sent, read = settings.full(command.topic), settings.full(reading.topic)
        writers = _endpoints(node.get_publishers_info_by_topic(sent))
        rivals = [one for one in writers if one.node != node.get_fully_qualified_name()]
        problem = reading_problem(
            read,
            reading.type,
            _endpoints(node.get_publishers_info_by_topic(read)),
            reliability=reading.qos.reliability,
            alone=reading.type != TF,
            topics=topics,
        ) or writing_problem(
            sent,
            command.type,
            _endpoints(node.get_subscriptions_info_by_topic(sent)),
            rivals,
            reliability=command.qos.reliability,
            topics=topics,
        )
        if problem is None and battery is not None:
            name = settings.full(battery.topic)
            found = _endpoints(node.get_publishers_info_by_topic(name))
            problem = reading_problem(
                name, BATTERY, found, reliability="best_effort", topics=topics
            )
        services = dict(node.get_service_names_and_types())
        named = settings.services.named
        wrong = (
            service_problem(
                settings.full(name), services, both_ways=role == "arm" and "disarm" not in named
            )
            for role, name in named.items()
        )
        return problem or next((one for one in wrong if one is not None), None)

    def _await_clock(self) -> None:
        """Wait until a simulation's clock advances, in steps that are small enough."""
        if not self._settings.use_sim_time:
            return
        steps: list[float] = []
        last_s, until_s = self.now_s(), time.monotonic() + FIRST_WITHIN_S
        while len(steps) < 10:
            if time.monotonic() > until_s:
                raise RobotError(
                    f"/clock has advanced {len(steps)} times in {FIRST_WITHIN_S:g} s: start the "
                    "simulation, or state use_sim_time = false for a real robot"
                )
            time.sleep(0.0005)
            if (now_s := self.now_s()) != last_s:
                # The first step leads from 0 to the simulation's time.
                steps += [now_s - last_s] if last_s > 0 else []
                last_s = now_s
        step_s = min(steps)  # a process that waits for a processor sees several steps as one
        if step_s > CLOCK_STEP_MAX * self._settings.sample_time_s:
            raise RobotError(
                f"/clock advances by {step_s:.3g} s, too much for a sample time of "
                f"{self._settings.sample_time_s:g} s: publish it more often"
            )


@contextmanager
def _ros() -> Iterator[None]:
    """Say how to get ROS 2 where it cannot be imported."""
    try:
        yield
    except ImportError as error:
        raise RobotError(NO_ROS.format(error=error)) from error


def _type(name: str) -> Any:
    """Return the class of a message or service, such as `nav_msgs/msg/Odometry`."""
    package, kind, own = name.split("/")
    try:
        return getattr(import_module(f"{package}.{kind}"), own)
    except ImportError as error:
        own = package.replace("_", "-")
        raise RobotError(
            f"{name} cannot be imported ({error}): install the package ros-DISTRO-{own} of your "
            f"ROS 2, or the wheel ros-{own}"
        ) from error


def _new(name: str) -> Any:
    return _type(name)()


def _profile(qos: Qos) -> Any:
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    policies = {
        "reliable": ReliabilityPolicy.RELIABLE,
        "best_effort": ReliabilityPolicy.BEST_EFFORT,
    }
    return QoSProfile(depth=qos.depth, reliability=policies[qos.reliability])


def _endpoints(found: Sequence[Any]) -> list[Endpoint]:
    from rclpy.qos import ReliabilityPolicy

    def name(one: Any) -> str:
        # An endpoint may be found before the name of its node.
        full = f"{one.node_namespace.rstrip('/')}/{one.node_name}"
        return "a node whose name is unknown" if "_NODE_NAME_UNKNOWN_" in full else full

    return [
        Endpoint(
            name(one),
            one.topic_type,
            (
                "best_effort"
                if one.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
                else "reliable"
            ),
        )
        for one in found
    ]
