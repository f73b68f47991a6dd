# SPDX-License-Identifier: Apache-2.0
"""A STEP file (AP214) as CAD programs write it: a sixth of a cylinder's skin, rounded upwards, as an open shell."""

from __future__ import annotations

import math
from collections.abc import Sequence

HEAD = """ISO-10303-21;
HEADER;
FILE_DESCRIPTION((''),'2;1');
FILE_NAME('mould','2026-01-01T00:00:00',(''),(''),'','','');
FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));
ENDSEC;
DATA;
#1=APPLICATION_CONTEXT('core data for automotive mechanical design processes');
#2=APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,#1);
#3=PRODUCT_CONTEXT('',#1,'mechanical');
#4=PRODUCT('mould','mould','',(#3));
#5=PRODUCT_DEFINITION_FORMATION('','',#4);
#6=PRODUCT_DEFINITION_CONTEXT('part definition',#1,'design');
#7=PRODUCT_DEFINITION('design','',#5,#6);
#8=PRODUCT_DEFINITION_SHAPE('','',#7);
#9=(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(PREFIX,.METRE.));
#10=(NAMED_UNIT(*) PLANE_ANGLE_UNIT() SI_UNIT($,.RADIAN.));
#11=(NAMED_UNIT(*) SI_UNIT($,.STERADIAN.) SOLID_ANGLE_UNIT());
#12=UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-06),#9,'distance_accuracy_value','');
#13=(GEOMETRIC_REPRESENTATION_CONTEXT(3) GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#12))
GLOBAL_UNIT_ASSIGNED_CONTEXT((#9,#10,#11)) REPRESENTATION_CONTEXT('',''));
"""
Point = tuple[float, float, float]


class _Lines:
    def __init__(self) -> None:
        self.lines: list[str] = []

    def add(self, text: str) -> int:
        self.lines.append(f"#{20 + len(self.lines)}={text};")
        return 19 + len(self.lines)

    def triple(self, kind: str, values: Sequence[float]) -> int:
        return self.add(f"{kind}('',({','.join(f'{v:.9f}' for v in values)}))")

    def frame(self, p: Point, z: Point, x: Point) -> int:
        parts = self.triple("CARTESIAN_POINT", p), self.triple("DIRECTION", z), self.triple("DIRECTION", x)
        return self.add(f"AXIS2_PLACEMENT_3D('',{','.join(f'#{k}' for k in parts)})")

    def edge(self, begin: int, end: int, curve: int) -> int:
        return self.add(f"EDGE_CURVE('',#{begin},#{end},#{curve},.T.)")

    def line(self, p: Point) -> int:
        vector = self.add(f"VECTOR('',#{self.triple('DIRECTION', (0.0, 1.0, 0.0))},1.)")
        return self.add(f"LINE('',#{self.triple('CARTESIAN_POINT', p)},#{vector})")


def rounded_shell(radius: float, length: float, half_angle: float, in_mm: bool = True) -> str:
    """Text of the file; the axis of the cylinder is y, its crest at (0, 0, radius). Lengths in mm or m."""
    s = _Lines()
    y, z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    ends = (0.0, -0.5 * length, 0.0), (0.0, 0.5 * length, 0.0)
    corners = [
        (radius * math.sin(a), c[1], radius * math.cos(a)) for c in ends for a in (-half_angle, half_angle)
    ]
    vertices = [s.add(f"VERTEX_POINT('',#{s.triple('CARTESIAN_POINT', p)})") for p in corners]
    arcs = [
        s.edge(vertices[2 * k], vertices[2 * k + 1], s.add(f"CIRCLE('',#{s.frame(c, y, z)},{radius:.9f})"))
        for k, c in enumerate(ends)
    ]
    sides = [s.edge(vertices[k], vertices[k + 2], s.line(corners[k])) for k in (0, 1)]
    around = ((arcs[0], "T"), (sides[1], "T"), (arcs[1], "F"), (sides[0], "F"))
    edges = [s.add(f"ORIENTED_EDGE('',*,*,#{edge},.{way}.)") for edge, way in around]
    loop = s.add(f"EDGE_LOOP('',({','.join(f'#{e}' for e in edges)}))")
    bound = s.add(f"FACE_OUTER_BOUND('',#{loop},.T.)")
    skin = s.add(f"CYLINDRICAL_SURFACE('',#{s.frame(ends[0], y, z)},{radius:.9f})")
    face = s.add(f"ADVANCED_FACE('',(#{bound}),#{skin},.T.)")
    shell = s.add(f"OPEN_SHELL('',(#{face}))")
    model = s.add(f"SHELL_BASED_SURFACE_MODEL('',(#{shell}))")
    origin = s.frame((0.0, 0.0, 0.0), z, (1.0, 0.0, 0.0))
    shape = s.add(f"MANIFOLD_SURFACE_SHAPE_REPRESENTATION('',(#{origin},#{model}),#13)")
    s.add(f"SHAPE_DEFINITION_REPRESENTATION(#8,#{shape})")
    head = HEAD.replace("PREFIX", ".MILLI." if in_mm else "$")
    return head + "\n".join(s.lines) + "\nENDSEC;\nEND-ISO-10303-21;\n"
