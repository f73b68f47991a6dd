# SPDX-License-Identifier: Apache-2.0
"""What is fuzzed: for each reader valid files, how they are mutated, and the call that reads them."""

from __future__ import annotations

import json
import random
import shutil
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from mutate import (
    mutate_bytes,
    mutate_formula,
    mutate_packets,
    mutate_recording,
    mutate_table,
    mutate_words,
    mutate_xml,
    mutate_yaml,
)

ROOT = Path(__file__).resolve().parents[2]
TESTS = ("irec_calibration/test", "irec_calibration/test/recording", "irec_calibration/test/procedure")
PATHS = ("irec_calibration", "irec_correction", "irec_sim", *TESTS, "tools/fuzz")
sys.path[:0] = [str(ROOT / p) for p in PATHS]

Mutator = Callable[[bytes, random.Random], bytes]


@dataclass(frozen=True)
class Target:
    """file: of the folder that is mutated; read: of the folder. Errors in `allowed` with one line are right answers."""

    name: str
    file: str
    mutate: Mutator
    read: Callable[[Path], object]
    names_file: bool = True  # an error has to name the file; what comes over a wire has none


def make_corpus(folder: Path) -> None:
    """Valid files of every kind, small."""
    import synthetic
    import yaml
    from irec_calibration.identification.identify import identify
    from irec_calibration.identification.provenance import model_of
    from irec_calibration.model import blank_model
    from irec_calibration.model.file import save_model
    from irec_calibration.recertification.journal import Entry
    from irec_calibration.session.mcap_io import write_mcap
    from irec_calibration.session.table import write_table
    from wires import can_frames, rsi_packets

    session = synthetic.session(poses=3)
    write_table(session, folder / "session")
    write_mcap(session, folder / "session.mcap")
    big = synthetic.session(poses=12)
    save_model(model_of(identify(big, blank_model(("joint_torsion",)))), folder / "model.yaml")
    text = (folder / "model.yaml").read_text()
    tree = yaml.safe_load(text)
    tree["effects"].append(
        {"effect": "mine", "formula": "axis 3: c * tau ** 3", "parameters": {"c": {"value": 1e-9, "unit": "1"}}}
    )
    tree["history"] = [{"effect": "joint_torsion", "cv_rms_m": 1e-5}]
    (folder / "model.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
    for kind in ("cells", "robots", "truths"):
        shutil.copytree(ROOT / "config" / kind, folder / kind)
    poses = yaml.safe_load((folder / "cells" / "afp_poses.yaml").read_text())
    poses["poses"] = poses["poses"][:3]
    (folder / "cells" / "afp_poses.yaml").write_text(yaml.safe_dump(poses))
    shift = {"direction": [0, 0, 1.0], "share": 0.4, "time": 9.0, "station": 0}
    truth = {"format": "irec-truth/1", "compliance": {"axial": [1e-7] * 6, "transverse": [[1e-8, 2e-8]] * 6, "spread": 0.1},
             "effects": [{"effect": "joint_stiffening", "scale": 1.0, "parameters": {"joint": 1, "share": 1.0}},
                         {"effect": "station_shift", "parameters": shift}]}  # fmt: skip
    (folder / "truth.yaml").write_text(yaml.safe_dump(truth))
    (folder / "formula.txt").write_text("axis 3: c * tau ** 3 + d * sin(q) * min(tau_g_1, 5.0)")
    columns = {f"joint_{k + 1}": {"column": f"a{k + 1}", "unit": "rad"} for k in range(6)}
    columns |= {f"marker_{a}": {"column": a, "minus": "d", "unit": "mm"} for a in "xyz"} | {"stamp": {"column": "T", "unit": "s"}}
    robot = {"urdf": "robots/kr120_r2700_extra_ha.urdf", "serial": "S"}
    header = {"name": "x", "kind": "absolute", "robot": robot, "noise": {"tracker_m": 1e-5}}
    profile = {"format": "irec-import/1", "table": {"delimiter": ",", "decimal": "."}, "session": header, "columns": columns,
               "missing": {"text": ["NaN"], "marker": [0, 0, 0]}, "order_by": "stamp", "drop_incomplete": True}  # fmt: skip
    (folder / "import.yaml").write_text(yaml.safe_dump(profile))
    rows = ["T,a1,a2,a3,a4,a5,a6,x,y,z,d"] + [f"{i},0.1,-1.5,1.{i},0.2,0.3,0.4,1000,2,{i},0.5" for i in range(4)]
    (folder / "foreign.csv").write_text("\n".join(rows) + "\n")
    (folder / "align.yaml").write_text(
        yaml.safe_dump(
            {"format": "irec-align/1", "session": header, "joints": {"names": [f"axis_{k}" for k in "abcdef"]},
             "marker": {"topic": "/points", "scale": 0.001}}
        )
    )  # fmt: skip
    _write_foreign(folder / "foreign.mcap")
    _write_run(folder / "run.mcap")
    rows = [f"{0.004 * i},{0.01 * i},1,2,{-3 * i}" for i in range(20)]
    (folder / "profile.csv").write_text("\n".join(["stamp,joint_1,force_x,force_y,force_z", *rows]) + "\n")
    (folder / "S").mkdir()
    figures = {"run": "2026-01-02_1", "largest_m": 1e-4}
    entry = Entry("put_in_force", "0001", 64 * "a", "pass", "N", "2026", figures)
    entry = replace(entry, entry_sha256=entry.digest())
    (folder / "S" / "journal.jsonl").write_text(json.dumps(asdict(entry)) + "\n")
    (folder / "joints.yaml").write_text(
        "format: irec-joints/1\nstep: 0.004\n"
        + "".join(f"{c}: {{columns: [{c}_1], unit: rad}}\n" for c in ("motor", "link", "torque"))
    )
    lines = ["motor_1,link_1,torque_1"] + [f"{0.1 * i},{0.1 * i + 1e-4},{5 * i}" for i in range(50)]
    (folder / "joints.csv").write_text("\n".join(lines) + "\n")
    (folder / "rsi.xml").write_bytes(rsi_packets())
    (folder / "can.bin").write_bytes(can_frames())
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.2]])
    (folder / "mesh.obj").write_text("".join(f"v {a} {b} {c}\n" for a, b, c in points) + "f 1 2 3\nf 1 3 4\n")
    stl = bytearray(80) + (2).to_bytes(4, "little")
    for t in ((0, 1, 2), (0, 2, 3)):
        stl += np.zeros(3, "<f4").tobytes() + points[list(t)].astype("<f4").tobytes() + b"\0\0"
    (folder / "mesh.stl").write_bytes(bytes(stl))


def _write_foreign(path: Path) -> None:
    """A short recording of somebody else: joint states with names of his own, and tracker points."""
    from irec_calibration.recording import BagWriter
    from test_foreign_bags import Foreign, joint_state, vectors

    names = [f"axis_{k}" for k in "abcdef"]
    with BagWriter(path, Foreign()) as writer:
        joints = writer.add_topic("/joints", "sensor_msgs/msg/JointState")
        points = writer.add_topic("/points", "geometry_msgs/msg/PointStamped")
        for i in range(120):
            t = 100.0 + 0.02 * i
            q = np.array([0.0, -1.5, 1.5, 0.0, 0.5, 0.0]) + 0.3 * np.sin(2.0 * (t - 100.0) + np.arange(6))
            writer.write(joints, joint_state(t, names, q), round(1e9 * t))
            if i % 3 == 0:
                writer.write(points, vectors(t, *(1000.0 * q[:3])), round(1e9 * t))


def _write_run(path: Path) -> None:
    """A run that was broken off in its second pose."""
    from test_procedure_recorder import recorder, write_pose

    run = recorder(path)
    write_pose(run, 1)
    write_pose(run, 2, cases=2, complete=False)
    run.close()


def targets() -> tuple[Target, ...]:
    import synthetic
    from irec_calibration.cell import read_cell
    from irec_calibration.cell.cell import MeshSurface
    from irec_calibration.commands.check import check_file
    from irec_calibration.effects.formula import FormulaEffect
    from irec_calibration.effects.of_session import scene_of
    from irec_calibration.errors import RobotError
    from irec_calibration.files.regular import URDF_LIMIT, read_text
    from irec_calibration.model.file import load_model
    from irec_calibration.poses.store import read_poses
    from irec_calibration.procedure.settings import read_acceptance, read_settings
    from irec_calibration.recertification.store import Store
    from irec_calibration.recording import BagReader
    from irec_calibration.recording.survey import survey
    from irec_calibration.robot import Robot
    from irec_calibration.robot.transforms import LinkTree
    from irec_calibration.sensors.joint_recording import read_recordings
    from irec_calibration.session import read_session
    from irec_calibration.session.align import align_bag
    from irec_calibration.session.foreign import import_table
    from irec_correction.preview import read_profile
    from irec_sim.cellfile import read_cell as read_sim_cell
    from irec_sim.truth import read_truth, truth_problems
    from test_procedure_recorder import recorder

    scene = scene_of(synthetic.session(poses=2))

    def checked(path: Path) -> None:
        for problem in check_file(path)["problems"]:
            if "\n" in problem or str(path) not in problem:
                raise AssertionError(f"a problem of more than a line, or without the file: {problem!r}")

    def cell(folder: Path) -> None:
        path = folder / "cells" / "afp.yaml"
        checked(path)
        found = read_cell(path)
        read_settings(found)
        read_acceptance(found)

    def poses(folder: Path) -> None:
        checked(folder / "cells" / "afp_poses.yaml")
        read_poses(folder / "cells" / "afp_poses.yaml")

    def model(folder: Path) -> None:
        checked(folder / "model.yaml")
        load_model(folder / "model.yaml")

    def robot(folder: Path) -> None:
        found = Robot.from_urdf(folder / "robots" / "ur5.urdf")
        q = np.zeros((2, found.n_joints))
        found.kinematics(q)
        found.gravity_torque(q)

    def tree(folder: Path) -> None:
        path = folder / "robots" / "ur5.urdf"
        found = LinkTree(read_text(path, "robot description", RobotError, URDF_LIMIT), str(path))
        found.fixed()
        found.at(dict.fromkeys(found.moving, 0.3))

    def formula(folder: Path) -> None:
        effect = FormulaEffect("mine", (folder / "formula.txt").read_bytes().decode("utf-8", "replace"))
        parameters = effect.parameters(scene)
        effect.displacement(scene, np.array([p.start for p in parameters]))

    def session(folder: Path) -> None:
        checked(folder / "session" / "session.yaml")
        read_session(folder / "session")

    def surveyed(folder: Path) -> None:
        survey(BagReader(folder / "session.mcap"))
        read_session(folder / "session.mcap")

    def truth(folder: Path) -> None:
        truth_problems(folder / "truth.yaml")
        read_truth(folder / "truth.yaml", "afp").physics()

    def imported(folder: Path) -> None:
        import_table(folder / "import.yaml", folder / "foreign.csv", folder / "out")

    def simulated(folder: Path) -> None:
        read_sim_cell(folder / "cells" / "afp.yaml")

    def resumed(folder: Path) -> None:
        (folder / "run.mcap.part").unlink(missing_ok=True)
        recorder(folder / "run.mcap", resume=True).close()

    def journal(folder: Path) -> None:
        store = Store(folder, "S")
        store.in_force_entry()
        store.last_certificate()

    from wires import read_can, read_rsi

    flat = (np.eye(3), np.zeros(3))
    return (
        Target("session.yaml", "session/session.yaml", mutate_yaml, session),
        Target("samples.csv", "session/samples.csv", mutate_table, lambda f: read_session(f / "session")),
        Target("session urdf", "session/robot.urdf", mutate_xml, lambda f: read_session(f / "session")),
        Target("mcap", "session.mcap", mutate_recording, surveyed),
        Target("cell", "cells/afp.yaml", mutate_yaml, cell),
        Target("poses", "cells/afp_poses.yaml", mutate_yaml, poses),
        Target("model", "model.yaml", mutate_yaml, model),
        Target("urdf", "robots/ur5.urdf", mutate_xml, robot),
        Target("formula", "formula.txt", mutate_formula, formula, names_file=False),
        Target("RSI packets", "rsi.xml", mutate_packets, read_rsi, names_file=False),
        Target("CAN frames", "can.bin", mutate_bytes, read_can, names_file=False),
        Target("import profile", "import.yaml", mutate_yaml, imported),
        Target("foreign table", "foreign.csv", mutate_table, imported),
        Target("align profile", "align.yaml", mutate_yaml, lambda f: align_bag(f / "foreign.mcap", f / "align.yaml")),
        Target("foreign recording", "foreign.mcap", mutate_recording, lambda f: align_bag(f / "foreign.mcap", f / "align.yaml")),
        Target("force profile", "profile.csv", mutate_table, lambda f: read_profile(f / "profile.csv", ("joint_1",))),
        Target("resumed run", "run.mcap", mutate_recording, resumed, names_file=False),
        Target("journal", "S/journal.jsonl", lambda d, r: mutate_words(d.decode(), r).encode(), journal),
        Target("urdf for /tf", "robots/ur5.urdf", mutate_xml, tree),
        Target("joints profile", "joints.yaml", mutate_yaml, lambda f: read_recordings(f / "joints.csv", f / "joints.yaml")),
        Target("joints table", "joints.csv", mutate_table, lambda f: read_recordings(f / "joints.csv", f / "joints.yaml")),
        Target("truth", "truth.yaml", mutate_yaml, truth),
        Target("simulator's cell", "cells/afp.yaml", mutate_yaml, simulated),
        Target("simulator's urdf", "robots/kr120_r2700_extra_ha.urdf", mutate_xml, simulated),
        Target("mesh.stl", "mesh.stl", mutate_bytes, lambda f: MeshSurface.from_file(f / "mesh.stl", *flat)),
        Target("mesh.obj", "mesh.obj", lambda d, r: mutate_words(d.decode(), r).encode(),
               lambda f: MeshSurface.from_file(f / "mesh.obj", *flat)),
    )  # fmt: skip
