# SPDX-License-Identifier: Apache-2.0
"""Where to begin, an example for each command, and what follows it."""

from __future__ import annotations

import shlex
from typing import Any

WELCOME = """irec: calibrate the elasticity of a robot in its cell, find what a model lacks, correct deflection under load.

You have measurements (a folder with session.yaml and samples.csv, or an MCAP recording)
  irec workbench SESSION     see and try everything in a page on this machine
  irec diagnose SESSION      where a model fails, which effect is missing, what to measure next
  irec report SESSION        the same as a page to print
You have a recording and do not know what is in it
  irec inspect RECORDING     what it holds and lacks
You have nothing yet
  irec init-cell -o CELL     describe your cell; irec show-cell draws it, irec check says what is wrong
  irec plan CELL             poses to measure in your cell
  make workbench             in a clone of the project: a session with an effect to be found

irec COMMAND --help explains one command with an example; irec --help lists them all."""

# command: (example, what comes out)
EXAMPLES: dict[str, tuple[str, str]] = {
    "check": (
        "irec check config/cells/afp.yaml SESSION model.yaml",
        "one line for each thing that is wrong: file, line, key, value, limit; exit code 2 where there is one",
    ),
    "init-cell": (
        "irec init-cell -o mine/mine.yaml --urdf robot.urdf --serial R-1 --surface patch 1.2 1.4 2.5 4 \\\n"
        "      --surface-xyz 1.6 0 0.8 --station A 0.3 -2.5 1.8 --sensor-range 2000 --payload 120",
        "mine/mine.yaml, commented; lines marked CHECK are guesses; --ask asks for what is not given",
    ),
    "show-cell": ("irec show-cell mine/mine.yaml", "mine/mine.png: robot, surface, normals, stations, poses, lines of sight"),
    "plan": (
        "irec plan config/cells/afp.yaml -n 31 --d-max 0.175 -o poses.yaml",
        "poses.yaml, and a picture of the poses beside it",
    ),
    "solve": ("irec solve SESSION -o model.yaml", "model.yaml and a table of its parameters with standard errors"),
    "predict": ("irec predict model.yaml SESSION -o predictions.csv", "predictions.csv: a deflection for each loaded row"),
    "codec": ("irec codec SESSION -o codec", "codec/: a chart, arrays and a table; from how many poses on more do not help"),
    "compare": ("irec compare model.yaml SESSION -o compared", "figures on the terminal; compared/report.html and residuals.csv"),
    "diagnose": (
        "irec diagnose SESSION -o out",
        "a verdict; out/diagnosis.json, report.html and tables; exit code 1: something is missing",
    ),
    "add": (
        "irec add model.yaml 'axis 3: c * tau**3' SESSION -o model2.yaml",
        "model2.yaml, what changed, and whether the data support it",
    ),
    "remove": ("irec remove model2.yaml joint_stiffening SESSION -o model3.yaml", "model3.yaml and what changed"),
    "improve": ("irec improve SESSION -o improved", "improved/: model.yaml, ladder.json, diagnosis.json, report.html"),
    "report": (
        "irec report SESSION --model model.yaml -o report",
        "report/report.html: verdict, one figure, what to do next, evidence",
    ),
    "workbench": ("irec workbench SESSION --cell config/cells/afp.yaml", "a page on this machine only; Ctrl-C ends it"),
    "scene": ("irec scene SESSION --model model.yaml -o scene.mcap", "scene.mcap: open it with config/viewers/foxglove.json"),
    "history": ("irec history model2.yaml", "the versions that led to the model, with the error of each"),
    "effects": ("irec effects joint_stiffening", "the physics of one effect; without a name the catalogue"),
    "inspect": ("irec inspect session.mcap", "topics, rates, gaps, and what it lacks to be a session"),
    "export": ("irec export session.mcap -o table", "table/: session.yaml, samples.csv, robot.urdf"),
    "import": ("irec import table -o session.mcap", "session.mcap; with --profile a table from foreign columns"),
    "join": ("irec join SESSION MORE -o both", "both/: one session with the rows of all"),
    "joint-stiffness": ("irec joint-stiffness recordings/ -o stiffness", "stiffness of each joint with its standard error"),
    "latency": ("irec latency course.mcap", "delay from a reading to the motion it causes; parameter lead of the correction"),
    "posture": ("irec posture model.yaml SESSION cell.yaml", "predicted deviation turn by turn, and what hinders a turn"),
    "filter": ("irec filter course_*.mcap -o filter.csv", "filter.csv for filter.file of the correction"),
    "profile": ("irec profile course_*.mcap -o profile.csv", "profile.csv for preview.file of the correction; preview.slack"),
    "course-filter": (
        "irec course-filter model.yaml cell.yaml course_*.mcap --dry dry_*.mcap --swept sweep_*.mcap -o filter.csv",
        "filter.csv for filter.file of the correction",
    ),
    "links": ("irec links dry.mcap -o links.csv", "links.csv for links.file of the correction"),
    "modes": ("irec modes tap_left.mcap tap_right.mcap", "frequency, damping and share of each mode, posture by posture"),
    "tool-load": ("irec tool-load turning.mcap -o tool_load.yaml", "mass, centre of mass, bias; parameters for the nodes"),
    "rsi-config": ("irec rsi-config --address 192.168.1.10 -o rsi", "rsi/: Ethernet configuration, KRL example, README"),
    "completion": ('eval "$(irec completion bash)"', "code for the start file of your shell"),
}

# command: what to do next; {name} is an argument of the command
FOLLOWS: dict[str, str] = {
    "show-cell": "next: irec plan {cell}",
    "plan": "next: measure at these poses (Procedure 1), then: irec diagnose SESSION",
    "solve": "next: see what the model lacks: irec diagnose {session} --model {output}",
    "predict": "next: hold it against measurements: irec compare {model} {session}",
    "codec": "next: see what keeps the error from falling: irec diagnose {session}",
    "compare": "next: find out which effect is missing: irec diagnose {session} --model {model}",
    "scene": "next: open {output} in Foxglove with the layout config/viewers/foxglove.json",
    "history": "next: hold the model against a session: irec compare {model} SESSION",
    "export": "next: irec diagnose {output}",
    "import": "next: irec diagnose {output}",
    "join": "next: irec diagnose {output}",
    "inspect": "next: where it is a session: irec diagnose {bag}; else: irec import --help, irec export --help",
    "joint-stiffness": "next: hold it beside what a session says: irec solve SESSION",
}


def example(command: str) -> str:
    """For the end of a command's help."""
    if command not in EXAMPLES:
        return ""
    line, out = EXAMPLES[command]
    return f"example:\n  {line}\nwhat comes out:\n  {out}"


def what_follows(command: str, arguments: dict[str, Any]) -> str:
    """The next step after a command that does not say it itself, or an empty string."""
    if command == "effects" and arguments.get("effect"):
        return f"next: irec add model.yaml {arguments['effect']} SESSION -o model2.yaml"
    if command == "effects":
        return "next: irec effects ID for the physics of one; irec add model.yaml ID SESSION to add it"
    if command == "tool-load":
        out = arguments.get("output")
        return (
            f"next: start the nodes with params_file:={out}"
            if out
            else "next: write the nodes' parameters with -o tool_load.yaml"
        )
    if command == "solve" and arguments.get("without_tracker"):
        return f"next: see what it lacks: irec improve {shlex.quote(str(arguments['session']))} --without-tracker -o improved"
    if command == "plan" and arguments.get("to_tell"):
        session = shlex.quote(str(arguments["to_tell"]))
        return f"next: measure at these poses (Procedure 1), then: irec join {session} NEW_SESSION -o both && irec diagnose both"
    text = FOLLOWS.get(command, "")
    quoted = {k: shlex.quote(str(v)) for k, v in arguments.items() if v is not None}
    try:
        return text.format(**quoted)
    except KeyError:
        return ""
