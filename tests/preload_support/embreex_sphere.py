"""Asks Embree 4 with embreex, as trimesh does: what do rays hit that look at a sphere and the floor below it? Prints every answer."""
import numpy as np
from embreex import mesh_construction, rtcore_scene


def sphere(rings, sectors):
    """A unit sphere's vertices and triangles."""
    polar = np.linspace(0, np.pi, rings + 1)[:, None]
    around = np.linspace(0, 2 * np.pi, sectors, endpoint=False)[None, :]
    points = [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar) + 0 * around]
    a = (np.arange(rings)[:, None] * sectors + np.arange(sectors)).ravel()
    b = (np.arange(rings)[:, None] * sectors + (np.arange(sectors) + 1) % sectors).ravel()
    faces = np.concatenate([np.stack([a, b, a + sectors], 1), np.stack([b, b + sectors, a + sectors], 1)])
    return np.stack(points, -1).reshape(-1, 3).astype(np.float32), faces.astype(np.int32)


scene = rtcore_scene.EmbreeScene(robust=1)
ball = mesh_construction.TriangleMesh(scene, *sphere(24, 48))
corners = np.array([[-4, -4, -1], [4, -4, -1], [4, 4, -1], [-4, 4, -1]], np.float32)
floor = mesh_construction.TriangleMesh(scene, corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))

random = np.random.default_rng(1)
origins = (random.random((4000, 3)) * [6, 6, 1] + [-3, -3, 3]).astype(np.float32)
directions = (random.random((4000, 3)) * 2 - 1 - origins).astype(np.float32)
hits = scene.run(origins, directions, output=True)
occluded = scene.run(origins, directions, query="OCCLUDED")
for t, geometry, primitive in zip(hits["tfar"], hits["geomID"], hits["primID"]):
    print(f"{np.float32(t).view(np.uint32):08x} {geometry} {primitive if geometry >= 0 else -1}")
for answer in occluded:
    print(answer)
