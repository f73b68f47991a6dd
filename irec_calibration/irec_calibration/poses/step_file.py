# SPDX-License-Identifier: Apache-2.0
"""Tooling from a STEP file: triangles in metres, written beside the cell file, which itself names meshes only.

Open CASCADE reads it (package cascadio), in a process of its own: what a broken file does to it does not reach irec.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import CellError, one_line
from ..files import write_file
from ..files.regular import read_bytes

STEP_SUFFIXES = (".step", ".stp")
DEVIATION = 5e-5  # m, of the triangles from the surface
BEND = 0.3  # rad between neighbouring triangles
LIMIT = 500_000_000  # bytes
PATIENCE = 300.0  # s
EXPORT = "or export STL from the CAD program (deviation 0.1 mm) and name that"
_PROGRAM = (
    "import sys, cascadio; sys.exit(cascadio.step_to_glb(sys.argv[1], sys.argv[2], tol_linear=float(sys.argv[3]),"
    " tol_angular=float(sys.argv[4])))"
)


def mesh_of_step(source: Path, target: Path) -> list[str]:
    """Triangles of all faces of a STEP file into an OBJ file, m.

    Returns what was done. Raises CellError: cascadio or trimesh is missing, the file can't be read or has no face.
    """
    missing = [name for name in ("cascadio", "trimesh") if find_spec(name) is None]
    if missing:
        raise CellError(f"{source}: reading STEP needs {' and '.join(missing)}: pip install 'irec_calibration[step]'; {EXPORT}")
    data = read_bytes(source, "STEP file", CellError, LIMIT)
    if not data.lstrip()[:12].upper().startswith(b"ISO-10303-21"):
        raise CellError(f"{source}: not a STEP file: it does not begin with ISO-10303-21; {EXPORT}")
    vertices, corners = _triangles(source, data)
    text = "".join(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in vertices)
    text += "".join(f"f {i + 1} {j + 1} {k + 1}\n" for i, j, k in corners)
    write_file(target, text, error=CellError)
    size = " x ".join(f"{v:.3g}" for v in np.ptp(vertices, axis=0))
    return [f"{source}: {len(corners)} triangles within {1e3 * DEVIATION:g} mm of its faces, {size} m large; wrote {target}"]


def _triangles(source: Path, data: bytes) -> tuple[Any, Any]:
    import trimesh

    with tempfile.TemporaryDirectory() as folder:
        step, glb = Path(folder) / "in.step", Path(folder) / "out.glb"
        step.write_bytes(data)
        command = [sys.executable, "-c", _PROGRAM, str(step), str(glb), f"{1e3 * DEVIATION:g}", f"{BEND:g}"]  # mm, rad
        try:
            done = subprocess.run(command, capture_output=True, timeout=PATIENCE, check=False)
        except subprocess.TimeoutExpired as error:
            raise CellError(f"{source}: not read within {PATIENCE:g} s; leave out what is not pressed on, {EXPORT}") from error
        if done.returncode != 0 or not glb.is_file():
            told = one_line(re.sub(r"\x1b\[[0-9;]*m", "", (done.stdout + done.stderr).decode(errors="replace")))[:200]
            raise CellError(f"{source}: not a STEP file that can be read: {told or f'code {done.returncode}'}; {EXPORT}")
        try:
            mesh: Any = trimesh.load(BytesIO(glb.read_bytes()), file_type="glb", force="mesh", process=False)
            vertices, corners = np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int64)
        except Exception as error:  # trimesh raises whatever its readers raise
            raise CellError(f"{source}: has no faces that can be pressed on: {one_line(str(error))[:200]}; {EXPORT}") from error
    if corners.size == 0:
        raise CellError(f"{source}: has no faces that can be pressed on; {EXPORT}")
    return vertices, corners
