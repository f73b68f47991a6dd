# SPDX-License-Identifier: Apache-2.0
"""Tooling surfaces: points uniform on the area, normals outward, distances along them."""

import numpy as np
import pytest
from irec_calibration.cell.along import distance_along
from irec_calibration.cell.mesh import TriangleMesh
from irec_calibration.cell.surface import Block, MeshSurface, Patch, SurfacePoints
from irec_calibration.errors import PlanError
from scipy.spatial.transform import Rotation

HERE = (Rotation.from_euler("xyz", [0.3, -0.7, 0.2]).as_matrix(), np.array([1.9, -0.2, 1.1]))
PATCH = Patch((1.0, 1.6), (2.0, -2.5), *HERE)
BLOCK = Block((0.8, 1.0, 0.5), ("+z", "-x", "+y"), *HERE)


def local(p):
    return (p - HERE[1]) @ HERE[0]


def test_points_of_a_patch_lie_on_it_and_normals_are_perpendicular_to_it():
    points = PATCH.sample(500, np.random.default_rng(0))
    x, y, z = local(points.p).T
    np.testing.assert_allclose(z, -(x**2) / 4.0 + y**2 / 5.0, atol=1e-12)
    along_x = np.column_stack([np.ones(500), np.zeros(500), -x / 2.0]) @ HERE[0].T
    along_y = np.column_stack([np.zeros(500), np.ones(500), y / 2.5]) @ HERE[0].T
    assert np.abs(np.sum(points.normal * along_x, axis=1)).max() < 1e-12
    assert np.abs(np.sum(points.normal * along_y, axis=1)).max() < 1e-12
    assert (points.normal @ HERE[0][:, 2] > 0).all()


def test_points_of_a_patch_are_uniform_on_its_area_not_on_its_projection():
    steep = Patch((2.0, 2.0), (0.7, 1e6), np.eye(3), np.zeros(3))
    x = steep.sample(40_000, np.random.default_rng(1)).p[:, 0]
    grid = np.linspace(-1, 1, 4001)
    density = np.sqrt(1 + (grid / 0.7) ** 2)
    share = density[np.abs(grid) < 0.5].sum() / density.sum()  # 0.42; it would be 0.5 on the projection
    assert np.mean(np.abs(x) < 0.5) == pytest.approx(share, abs=0.01)


def test_faces_of_a_block_are_hit_in_proportion_to_their_area_with_outward_normals():
    points = BLOCK.sample(20_000, np.random.default_rng(2))
    p, normal = local(points.p), points.normal @ HERE[0]
    top, front, side = normal[:, 2] > 0.9, normal[:, 0] < -0.9, normal[:, 1] > 0.9
    assert (top | front | side).all()
    np.testing.assert_allclose([top.mean(), front.mean(), side.mean()], np.array([0.8, 0.5, 0.4]) / 1.7, atol=0.012)
    np.testing.assert_allclose(p[front, 0], -0.4)
    np.testing.assert_allclose(points.edge_distance[top], np.min([0.4, 0.5] - np.abs(p[top, :2]), axis=1), atol=1e-12)


@pytest.mark.parametrize("surface", [PATCH, BLOCK], ids=["patch", "block"])
def test_the_triangles_of_a_surface_face_outward(surface):
    mesh = surface.mesh()
    points = surface.sample(300, np.random.default_rng(3))
    centre = mesh.vertices[mesh.corners].mean(axis=1)
    nearest = np.argmin(np.linalg.norm(points.p[:, None] - centre, axis=2), axis=1)
    inside = points.edge_distance > 0.06
    assert (np.sum(mesh.normal[nearest] * points.normal, axis=1)[inside] > 0.97).all()


def test_distance_along_a_block_goes_around_its_edge():
    corner = np.array([[0.0, 0.2, 0.25], [-0.4, 0.2, 0.0]])  # on the top and on the front, local frame
    points = SurfacePoints(corner @ HERE[0].T + HERE[1], np.array([[0, 0, 1.0], [-1.0, 0, 0]]) @ HERE[0].T, np.full(2, 0.2))
    distance = distance_along(BLOCK.mesh(), points)(0)
    assert distance[0] == 0.0
    assert distance[1] == pytest.approx(0.4 + 0.25, rel=0.03)


def test_distance_along_a_surface_is_hardly_longer_than_a_straight_line_on_a_flat_one():
    flat = Patch((1.0, 1.0), (1e6, 1e6), np.eye(3), np.zeros(3))
    points = flat.sample(400, np.random.default_rng(4))
    along = distance_along(flat.mesh(), points)(7)
    straight = np.linalg.norm(points.p - points.p[7], axis=1)
    assert (along >= straight - 1e-12).all()
    assert (along[straight > 0.1] < 1.06 * straight[straight > 0.1]).all()


def test_a_mesh_file_is_sampled_like_the_block_it_was_made_from(tmp_path):
    trimesh = pytest.importorskip("trimesh", reason="extra 'mesh' is not installed")
    box = trimesh.creation.box(extents=(800.0, 1000.0, 500.0))
    box.export(tmp_path / "block.stl")
    surface = MeshSurface.from_file(tmp_path / "block.stl", *HERE, scale=1e-3)
    points = surface.sample(4000, np.random.default_rng(5))
    p, normal = local(points.p), points.normal @ HERE[0]
    np.testing.assert_allclose(np.max(np.abs(p) / [0.4, 0.5, 0.25], axis=1), 1.0, atol=1e-6)
    assert np.mean(normal[:, 2] > 0.9) == pytest.approx(0.8 / 3.4, abs=0.03)
    assert (np.sum(p * normal, axis=1) > 0).all()
    top = normal[:, 2] > 0.9
    np.testing.assert_allclose(points.edge_distance[top], np.min([0.4, 0.5] - np.abs(p[top, :2]), axis=1), atol=0.01)


def test_a_mesh_file_that_is_no_mesh_is_refused_by_name(tmp_path):
    pytest.importorskip("trimesh", reason="extra 'mesh' is not installed")
    (tmp_path / "broken.stl").write_text("not a mesh")
    with pytest.raises(PlanError, match=r"broken\.stl"):
        MeshSurface.from_file(tmp_path / "broken.stl", *HERE)


def test_edges_of_a_triangle_mesh_are_the_border_and_the_bends():
    folded = TriangleMesh(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1.0]]), np.array([[0, 1, 2], [1, 3, 2]], dtype=np.int64)
    )
    assert len(folded.sharp_edges()) == 5  # four of the border, one of the fold
    assert len(folded.sharp_edges(angle=np.pi)) == 4
