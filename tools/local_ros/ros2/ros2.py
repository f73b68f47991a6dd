# SPDX-License-Identifier: Apache-2.0
"""Stands in for the command `ros2` where ROS 2 is installed from wheels: of ros2cli there are none.

It takes those commands that the documents of irec use, written as for the real one:

    ros2 run PACKAGE EXECUTABLE [--ros-args ...]
    ros2 lifecycle set NODE TRANSITION          ros2 lifecycle get NODE
    ros2 action send_goal [--feedback] ACTION TYPE GOAL
    ros2 service call SERVICE TYPE [REQUEST]
    ros2 topic echo [--once] TOPIC [TYPE]
    ros2 param get NODE NAME                    ros2 param set NODE NAME VALUE          ros2 param describe NODE NAME
    ros2 pkg prefix [--share] PACKAGE

`ros2 launch` and `ros2 bag` are not among them: docs/commissioning.md says what stands for them. Exit code: 0; 1 where the node,
the server or the goal says no; 2 where what was typed can't be used; 130 after Ctrl+C.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from fields import FieldError, fill, interface, plain

WAIT = 10.0  # s for a node, a server or an answer
GOAL_ENDED = {4: "SUCCEEDED", 5: "CANCELED", 6: "ABORTED"}


class RefusedError(Exception):
    """Somebody said no, or did not answer."""


class Talk:
    """A node of this command, for the time of one command."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)  # Ctrl+C is answered here
        self.node = rclpy.create_node(f"ros2_stand_in_{os.getpid()}", start_parameter_services=False)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def until(self, condition: Callable[[], Any], what: str, seconds: float = WAIT) -> None:
        """Raises RefusedError after so many s."""
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                raise RefusedError(f"{what} within {seconds:g} s: is it running, with this ROS_DOMAIN_ID and namespace?")
            self.spin()

    def spin(self) -> None:
        """Whatever has come in."""
        self._executor.spin_once(timeout_sec=0.05)

    def call(self, kind: Any, name: str, request: Any, seconds: float = 3600.0) -> Any:
        """Answer of a service."""
        from irec_ros.seen import SeenBy

        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, f"no service {name}")
        self.until(SeenBy(self.node, name), f"the server of {name} does not find this command")
        answer = client.call_async(request)
        self.until(answer.done, f"no answer of {name}", seconds)
        return answer.result()


def run(args: argparse.Namespace) -> int:
    """Become the executable, so that signals reach it."""
    found = [Path(p) / "lib" / args.package / args.executable for p in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if p]
    path = next((p for p in found if os.access(p, os.X_OK)), None)
    if path is None:
        there = sorted({p.name for f in found if f.parent.is_dir() for p in f.parent.iterdir()})
        raise FieldError(
            f"package {args.package} has no executable '{args.executable}'"
            + (f"; it has {', '.join(there)}" if there else ", or is not in AMENT_PREFIX_PATH: source tools/env.sh")
        )
    os.execv(path, [str(path), *args.arguments])


def not_here(args: argparse.Namespace) -> int:
    """Not among what stands in for ros2."""
    raise FieldError(
        f"{args.command} needs ROS 2 itself, which is installed from wheels here; docs/commissioning.md, 'Without the command"
        " ros2', says which `ros2 run` stands for it"
    )


def prefix(args: argparse.Namespace) -> int:
    """Where a package is installed."""
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix, get_package_share_directory

    try:
        print((get_package_share_directory if args.share else get_package_prefix)(args.package))
    except PackageNotFoundError as error:
        raise FieldError(f"package not found: {error}") from error
    return 0


def lifecycle_set(args: argparse.Namespace) -> int:
    """Ask for a transition by its name."""
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions

    talk = Talk()
    there = talk.call(GetAvailableTransitions, f"{args.node}/get_available_transitions", GetAvailableTransitions.Request())
    known = {t.transition.label: t.transition.id for t in there.available_transitions}
    if args.transition not in known:
        raise RefusedError(f"{args.node} can't {args.transition} now; it can {', '.join(known)}")
    request = ChangeState.Request(transition=Transition(id=known[args.transition], label=args.transition))
    if not talk.call(ChangeState, f"{args.node}/change_state", request).success:
        raise RefusedError(f"transition {args.transition} failed; {args.node} says why in its output")
    print("Transitioning successful")
    return 0


def lifecycle_get(args: argparse.Namespace) -> int:
    """State of a node."""
    from lifecycle_msgs.srv import GetState

    state = Talk().call(GetState, f"{args.node}/get_state", GetState.Request()).current_state
    print(f"{state.label} [{state.id}]")
    return 0


def service_call(args: argparse.Namespace) -> int:
    """Call a service and show its answer."""
    kind = interface(args.type, "srv")
    request = fill(kind.Request(), _typed(args.request))
    answer = Talk().call(kind, args.service, request)
    print(_text(answer))
    return 0 if getattr(answer, "success", True) else 1


def send_goal(args: argparse.Namespace) -> int:
    """Send a goal, show what comes back, and cancel it on Ctrl+C."""
    from irec_ros.seen import SeenBy
    from rclpy.action import ActionClient

    kind = interface(args.type, "action")
    goal = fill(kind.Goal(), _typed(args.goal))
    talk = Talk()
    client = ActionClient(talk.node, kind, args.action)
    talk.until(client.server_is_ready, f"no action server {args.action}")
    talk.until(SeenBy.of_action(talk.node, args.action), f"the server of {args.action} does not find this command")

    def show(message: Any) -> None:
        print(f"Feedback:\n{_indented(message.feedback)}", flush=True)

    asked = client.send_goal_async(goal, feedback_callback=show if args.feedback else None)
    talk.until(asked.done, f"no answer of {args.action}")
    handle = asked.result()
    if not handle.accepted:
        raise RefusedError("Goal was rejected; the server says why in its output")
    print("Goal accepted", flush=True)
    result = handle.get_result_async()
    cancelled = False
    while not result.done():
        try:
            talk.spin()
        except KeyboardInterrupt:
            if cancelled:
                raise
            cancelled = True
            print("Canceling goal; once more Ctrl+C leaves it to itself", file=sys.stderr, flush=True)
            handle.cancel_goal_async()
    ended = result.result()
    print(f"Result:\n{_indented(ended.result)}\nGoal finished with status: {GOAL_ENDED.get(ended.status, ended.status)}")
    return 0 if ended.status == 4 and getattr(ended.result, "success", True) else 1


def topic_echo(args: argparse.Namespace) -> int:
    """Show messages of a topic."""
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    talk = Talk()
    name = talk.node.resolve_topic_name(args.topic)

    def offers() -> Any:
        return talk.node.get_publishers_info_by_topic(name)

    given = args.type
    if not given:
        talk.until(offers, f"nobody publishes {name}")
        given = offers()[0].topic_type
    qos = QoSProfile(depth=50)
    if any(o.qos_profile.reliability is ReliabilityPolicy.BEST_EFFORT for o in offers()):
        qos.reliability = ReliabilityPolicy.BEST_EFFORT
    if offers() and all(o.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL for o in offers()):
        qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
    seen = 0

    def show(message: Any) -> None:
        nonlocal seen
        if not (args.once and seen):
            print(f"{_text(message)}\n---", flush=True)
        seen += 1

    talk.node.create_subscription(interface(given, "msg"), name, show, qos)
    while not (args.once and seen):
        talk.spin()
    return 0


def param(args: argparse.Namespace) -> int:
    """Get, set or describe one parameter."""
    from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
    from rclpy.parameter import Parameter, parameter_value_to_python

    talk = Talk()
    if args.verb == "set":
        wanted = Parameter(args.name, value=yaml.safe_load(args.value)).to_parameter_msg()
        answer = talk.call(SetParameters, f"{args.node}/set_parameters", SetParameters.Request(parameters=[wanted])).results[0]
        if not answer.successful:
            raise RefusedError(f"Setting parameter failed: {answer.reason}")
        print("Set parameter successful")
        return 0
    kind: Any = GetParameters if args.verb == "get" else DescribeParameters
    service = f"{args.node}/{'get' if args.verb == 'get' else 'describe'}_parameters"
    answer = talk.call(kind, service, kind.Request(names=[args.name]))
    found = answer.values if args.verb == "get" else answer.descriptors
    if not found or (args.verb == "get" and found[0].type == 0):
        raise RefusedError(f"{args.node} has no parameter '{args.name}'")
    print(f"value: {parameter_value_to_python(found[0])}" if args.verb == "get" else _text(found[0]))
    return 0


def _typed(text: str) -> Any:
    return yaml.safe_load(text) if text.strip() else {}


def _text(message: Any) -> str:
    return yaml.safe_dump(plain(message), sort_keys=False, allow_unicode=True, width=10**6).rstrip()


def _indented(message: Any) -> str:
    return "\n".join("    " + line for line in _text(message).splitlines())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("ros2", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    groups = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    verbs: dict[str, Any] = {}

    def verb(group: str, name: str, does: Callable[[argparse.Namespace], int], *arguments: str) -> argparse.ArgumentParser:
        if group not in verbs:
            verbs[group] = groups.add_parser(group).add_subparsers(dest="verb", required=True, metavar="VERB")
        made: argparse.ArgumentParser = verbs[group].add_parser(name, description=does.__doc__)
        for argument in arguments:
            made.add_argument(argument.rstrip("?"), **({"nargs": "?", "default": ""} if argument.endswith("?") else {}))
        made.set_defaults(does=does)
        return made

    running = groups.add_parser("run", description=run.__doc__)
    running.add_argument("package")
    running.add_argument("executable")
    running.add_argument("arguments", nargs=argparse.REMAINDER)
    running.set_defaults(does=run)
    for name in ("launch", "bag"):
        without = groups.add_parser(name, description=not_here.__doc__)
        without.add_argument("arguments", nargs=argparse.REMAINDER)
        without.set_defaults(does=not_here)
    verb("lifecycle", "set", lifecycle_set, "node", "transition")
    verb("lifecycle", "get", lifecycle_get, "node")
    verb("service", "call", service_call, "service", "type", "request?")
    verb("action", "send_goal", send_goal, "action", "type", "goal").add_argument("-f", "--feedback", action="store_true")
    verb("topic", "echo", topic_echo, "topic", "type?").add_argument("--once", action="store_true")
    verb("pkg", "prefix", prefix, "package").add_argument("--share", action="store_true")
    verb("param", "get", param, "node", "name")
    verb("param", "describe", param, "node", "name")
    verb("param", "set", param, "node", "name", "value")
    return parser


def main() -> int:
    """Carry out one command; exit code."""
    args = _parser().parse_args()
    try:
        return int(args.does(args))
    except (FieldError, yaml.YAMLError) as error:
        print(f"ros2: {error}", file=sys.stderr)
        return 2
    except RefusedError as error:
        print(f"ros2: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
