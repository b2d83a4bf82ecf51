"""A scene for Blender's Cycles with what makes recording hard; renders it to the path behind `--`, with the parts named behind that."""
import math
import sys

import bpy

path, *parts = sys.argv[sys.argv.index("--") + 1 :]
size = 256 if "large" in parts else 96

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.engine = "CYCLES"
scene.cycles.device = "CPU"
scene.cycles.samples = 8
scene.cycles.seed = 1
scene.cycles.use_denoising = False
scene.cycles.use_adaptive_sampling = False
scene.render.resolution_x = scene.render.resolution_y = size
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.image_settings.color_depth = "32"
scene.render.filepath = path
scene.render.use_motion_blur = "motion" in parts


def material(name, **inputs):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    for key, value in inputs.items():
        made.node_tree.nodes["Principled BSDF"].inputs[key.replace("_", " ")].default_value = value
    return made


def last(made):
    bpy.context.object.data.materials.append(made)
    return bpy.context.object


bpy.ops.mesh.primitive_plane_add(size=10)
last(material("floor"))
bpy.ops.mesh.primitive_monkey_add(location=(0, 0, 1))
last(material("head", Subsurface=0.3 if "subsurface" in parts else 0.0))
bpy.ops.mesh.primitive_uv_sphere_add(location=(1.8, -0.8, 0.7), radius=0.7)
ball = last(material("glass", Transmission=1.0, Roughness=0.0))
if "motion" in parts:
    ball.keyframe_insert("location", frame=0)
    ball.location.x += 1
    ball.keyframe_insert("location", frame=2)

# Cubes that let shadow rays through share a mesh.
bpy.ops.mesh.primitive_cube_add(location=(-2, -1, 0.5), size=0.8)
cube = last(material("veil", Alpha=0.5))
for number in range(4 if "instances" in parts else 0):
    copy = bpy.data.objects.new(f"copy {number}", cube.data)
    copy.location = (-2.5 + number, 2, 0.6)
    copy.rotation_euler = (0.3 * number, 0.2, 0.5 * number)
    copy.scale = (0.5, 0.7, 0.9)
    scene.collection.objects.link(copy)

if "hair" in parts:
    bpy.ops.mesh.primitive_uv_sphere_add(location=(-1, -2, 0.5), radius=0.4)
    head = bpy.context.object
    head.modifiers.new("hair", "PARTICLE_SYSTEM")
    settings = head.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length = "HAIR", 300, 0.4

bpy.ops.object.light_add(type="AREA", location=(2, -3, 5))
bpy.context.object.data.energy = 500
bpy.ops.object.light_add(type="SUN", rotation=(0.5, 0.2, 0))
bpy.ops.object.camera_add(location=(0, -8, 4), rotation=(math.radians(67), 0, 0))
scene.camera = bpy.context.object
bpy.ops.render.render(write_still=True)
