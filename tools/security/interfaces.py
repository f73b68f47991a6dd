# SPDX-License-Identifier: Apache-2.0
"""What each node may open: the one table from which the policies are written, and against which running nodes are held."""

from __future__ import annotations

from dataclasses import dataclass

PARAMETERS = ("describe_parameters", "get_parameter_types", "get_parameters", "list_parameters", "set_parameters",
              "set_parameters_atomically", "get_type_description")  # fmt: skip
LIFECYCLE = ("change_state", "get_state", "get_available_states", "get_available_transitions", "get_transition_graph")


@dataclass(frozen=True)
class Node:
    """Names relative to the cell's namespace unless they begin with /; `~/` is the node's own.

    Attributes:
        package, name: of the node. publish, subscribe: topics. serve, call: services. execute, send: actions.
        sometimes: names of the above that are open only with some parameters or phases of its life.
    """

    package: str
    name: str
    publish: tuple[str, ...] = ()
    subscribe: tuple[str, ...] = ()
    serve: tuple[str, ...] = ()
    call: tuple[str, ...] = ()
    execute: tuple[str, ...] = ()
    send: tuple[str, ...] = ()
    sometimes: tuple[str, ...] = ()
    lifecycle: bool = False

    @property
    def publishes(self) -> frozenset[str]:
        """With what every node publishes."""
        own = ("~/transition_event",) if self.lifecycle else ()
        return frozenset((*self.publish, "/rosout", "/parameter_events", *own))

    @property
    def subscribes(self) -> frozenset[str]:
        """With the clock of a simulation."""
        return frozenset((*self.subscribe, "/clock"))

    @property
    def serves(self) -> frozenset[str]:
        """With the services of parameters and life cycle."""
        own = [f"~/{s}" for s in (*PARAMETERS, *(LIFECYCLE if self.lifecycle else ()))]
        return frozenset((*self.serve, *own))


OF_EVERY_NODE = frozenset({"/rosout", "/parameter_events", "/clock", "~/transition_event",
                           *(f"~/{s}" for s in (*PARAMETERS, *LIFECYCLE))})  # fmt: skip
READINGS = ("joint_states", "tcp_pose", "wrench", "wrench_raw", "tracker/point", "robot/state", "temperature/*")
RECORDED = ("joint_states", "tcp_pose", "wrench", "wrench_raw", "tracker/point", "robot/state", "robot_description",
            "irec/offset", "irec/correction/state", "irec/procedure/status", "irec/procedure/load_case",
            "irec/procedure/event")  # fmt: skip

NODES = (
    Node(
        "irec_calibration", "procedure_node", lifecycle=True,
        publish=("irec/procedure/status", "irec/procedure/load_case", "irec/procedure/event", "robot/force_setpoint",
                 "sim/follower", "/diagnostics"),
        subscribe=(*READINGS, "irec/correction/state"),
        serve=("irec/procedure/pause", "irec/procedure/resume"),
        call=("robot/set_control_mode",), execute=("irec/run_procedure",), send=("robot/move",),
        sometimes=("sim/follower", "temperature/*"),
    ),
    Node(
        "irec_calibration", "calibration_node",
        publish=("/diagnostics",),
        subscribe=("irec/procedure/status",),
        serve=("irec/solve", "irec/analyse", "irec/recalibrate", "irec/put_in_force"),
        call=("irec/correction/activate_model",), execute=("irec/recertify",), send=("irec/run_procedure",),
        sometimes=("/diagnostics",),
    ),
    Node(  # opened by calibration_node for the seconds in which it looks at the instruments
        "irec_calibration", "calibration_node_listener",
        publish=("/diagnostics",), subscribe=("wrench", "tracker/point", "joint_states", "robot/state", "temperature/*"),
        sometimes=("wrench", "tracker/point", "joint_states", "robot/state", "temperature/*", "/diagnostics"),
    ),
    Node(
        "irec_calibration", "recorder",
        publish=("/diagnostics",), subscribe=RECORDED, serve=("~/start", "~/stop"), sometimes=(*RECORDED, "/diagnostics"),
    ),
    Node(
        "irec_calibration", "tf_node",
        publish=("/tf", "/tf_static", "/diagnostics"), subscribe=("joint_states", "robot_description"),
        sometimes=("robot_description", "/diagnostics"),
    ),
    Node(
        "irec_correction", "correction_node", lifecycle=True,
        publish=("irec/offset", "irec/correction/state", "irec/wrench_process", "sim/follower", "/diagnostics"),
        subscribe=("wrench", "wrench_raw", "joint_states", "robot_description", "robot/state"),
        serve=("irec/correction/activate_model", "irec/wrench/record_orientation", "irec/wrench/identify_tool_load"),
        sometimes=("irec/offset", "irec/correction/state", "irec/wrench_process", "sim/follower", "wrench", "wrench_raw",
                   "joint_states", "robot/state", "irec/correction/activate_model", "irec/wrench/record_orientation",
                   "irec/wrench/identify_tool_load", "/diagnostics"),
    ),
    Node(
        "irec_correction", "rsi_bridge", lifecycle=True,
        publish=("joint_states", "tcp_pose", "irec/offset", "irec/wrench_process", "irec/correction/state", "~/state",
                 "/diagnostics"),
        subscribe=("wrench", "wrench_raw", "irec/offset", "robot_description"),
        serve=("irec/correction/activate_model", "irec/wrench/record_orientation", "irec/wrench/identify_tool_load"),
        sometimes=("irec/offset", "irec/wrench_process", "irec/correction/state", "~/state", "wrench", "wrench_raw",
                   "irec/correction/activate_model", "irec/wrench/record_orientation", "irec/wrench/identify_tool_load",
                   "robot_description", "/diagnostics"),
    ),
    Node("irec_correction", "can_ft_node", lifecycle=True, publish=("wrench_raw", "/diagnostics"), serve=("~/bias",),
         sometimes=("/diagnostics",)),
    Node(
        "irec_sim", "cell",
        publish=("joint_states", "tcp_pose", "wrench", "wrench_raw", "tracker/point", "temperature/*", "robot/state",
                 "/diagnostics", "/clock", "robot_description"),
        subscribe=("robot/force_setpoint", "irec/offset", "sim/follower"),
        serve=("robot/set_control_mode",), execute=("robot/move",), sometimes=("temperature/*",),
    ),
    Node(  # the cell page of irec workbench
        "irec_calibration", "irec_cell_page", subscribe=("irec/procedure/status",),
        call=("irec/put_in_force", "irec/procedure/pause", "irec/procedure/resume"), send=("irec/recertify",),
        publish=("/diagnostics",), sometimes=("/diagnostics",),
    ),
    Node(  # ros2_control_driver, with the topics of its defaults
        "irec_calibration", "driver",
        publish=("tcp_pose", "wrench", "wrench_raw", "robot/state", "robot_description", "sim/follower",
                 "joint_trajectory_controller/joint_trajectory", "/diagnostics"),
        subscribe=("joint_states", "force_torque_sensor_broadcaster/wrench", "robot/force_setpoint", "irec/offset"),
        serve=("robot/set_control_mode", "robot/clear_fault"), execute=("robot/move",),
        sometimes=("sim/follower", "/diagnostics"),
    ),
    Node("irec_calibration", "tracker", publish=("tracker/point", "/diagnostics"), sometimes=("/diagnostics",)),
    Node("irec_sim", "simulator", publish=("/diagnostics",), serve=("sim/run_course", "sim/clear_fault"),
         sometimes=("/diagnostics",)),
)  # fmt: skip
