"""Casts 64 x 64 rays at a unit sphere with Open3D and says how many hit."""
import numpy as np
import open3d as o3d

sphere = o3d.geometry.TriangleMesh.create_sphere(1.0, resolution=40)
scene = o3d.t.geometry.RaycastingScene()
scene.add_triangles(
    o3d.core.Tensor(np.asarray(sphere.vertices, dtype=np.float32)),
    o3d.core.Tensor(np.asarray(sphere.triangles, dtype=np.uint32)),
)
side = np.linspace(-0.5, 0.5, 64, dtype=np.float32)
x, y = np.meshgrid(side, side)
rays = np.stack([0 * x, 0 * x, 0 * x - 3, x, y, 0 * x + 1], axis=-1).astype(np.float32)
distance = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
print(np.isfinite(distance).sum(), "of", distance.size, "rays hit")
