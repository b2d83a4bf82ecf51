// A cast picture with its depths, and lines, discs and faces drawn into it.
//
// Depth is near / distance along the line of sight: 1 at the near plane, 0 infinitely far, so that precision lies where it is needed.

struct Frame {
    eye: vec3<f32>,
    near: f32,
    // Half the image plane at distance 1, over its length squared: products with them give -1 to 1 across the image.
    right: vec3<f32>,
    width: f32,
    down: vec3<f32>,
    height: f32,
    forward: vec3<f32>,
    surface: f32,
}

struct Batch {
    opacity: f32,
    behind: f32,
    // Times the widths of lines and the sizes of points.
    scale: f32,
}

@group(0) @binding(0) var<uniform> frame: Frame;
@group(1) @binding(0) var<uniform> batch: Batch;
@group(1) @binding(0) var cast_color: texture_2d<f32>;
@group(1) @binding(1) var cast_depth: texture_2d<f32>;
@group(1) @binding(2) var smooth_sampler: sampler;

// Whether what lies behind surfaces is drawn, instead of what lies before them.
override BEHIND: bool = false;

// Overlays lie this much nearer than surfaces at the same place, so that a box's edge on a wall is seen.
const NEARER: f32 = 1.002;

fn seen(color: vec4<f32>, coverage: f32) -> vec4<f32> {
    let opacity = color.a * coverage * batch.opacity * select(1.0, batch.behind, BEHIND);
    if opacity <= 0.0 {
        discard;
    }
    return vec4<f32>(color.rgb, opacity);
}

fn clip(sight: vec3<f32>) -> vec4<f32> {
    return vec4<f32>(dot(sight, frame.right), -dot(sight, frame.down), frame.near * NEARER, dot(sight, frame.forward));
}

// The picture itself.

struct Surface {
    @builtin(position) position: vec4<f32>,
    @location(0) place: vec2<f32>,
}

@vertex
fn surface_vertex(@builtin(vertex_index) index: u32) -> Surface {
    let corner = vec2<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0);
    return Surface(vec4<f32>(corner, 0.0, 1.0), vec2<f32>(0.5 + 0.5 * corner.x, 0.5 - 0.5 * corner.y));
}

struct SurfacePixel {
    @location(0) color: vec4<f32>,
    @builtin(frag_depth) depth: f32,
}

@fragment
fn surface_fragment(surface: Surface) -> SurfacePixel {
    let size = vec2<f32>(textureDimensions(cast_depth));
    let texel = vec2<i32>(clamp(surface.place * size, vec2<f32>(0.0), size - 1.0));
    let distance = textureLoad(cast_depth, texel, 0).r;
    let color = textureSampleLevel(cast_color, smooth_sampler, surface.place, 0.0).rgb;
    let empty = vec3<f32>(0.12, 0.13, 0.155);
    // Distances are capped below infinity, which some drivers do not keep.
    let hit = distance < 1e37;
    let shown = select(color, mix(empty, color, frame.surface), hit);
    return SurfacePixel(vec4<f32>(shown, 1.0), select(0.0, clamp(frame.near / distance, 0.0, 1.0), hit));
}

// Lines: a rectangle along each.

struct LinePixel {
    @builtin(position) position: vec4<f32>,
    @location(0) color: vec4<f32>,
    @location(1) @interpolate(linear) across: f32,
    @location(2) half_width: f32,
}

@vertex
fn line_vertex(
    @builtin(vertex_index) index: u32,
    @location(0) start: vec4<f32>,
    @location(1) stop: vec3<f32>,
    @location(2) color: vec4<f32>,
) -> LinePixel {
    var a = start.xyz - frame.eye;
    var b = stop - frame.eye;
    let depth_a = dot(a, frame.forward);
    let depth_b = dot(b, frame.forward);
    // What is behind the eye is cut off first: it has no place in the image.
    if depth_a < frame.near && depth_b < frame.near {
        return LinePixel(vec4<f32>(0.0, 0.0, -1.0, 1.0), color, 0.0, 0.0);
    }
    if depth_a < frame.near {
        a = mix(a, b, (frame.near - depth_a) / (depth_b - depth_a));
    } else if depth_b < frame.near {
        b = mix(b, a, (frame.near - depth_b) / (depth_a - depth_b));
    }
    let clip_a = clip(a);
    let clip_b = clip(b);
    let pixels = 0.5 * vec2<f32>(frame.width, frame.height);
    let along = (clip_b.xy / clip_b.w - clip_a.xy / clip_a.w) * pixels;
    let reached = max(length(along), 1e-6);
    let direction = select(vec2<f32>(1.0, 0.0), along / reached, reached > 1e-5);
    let normal = vec2<f32>(-direction.y, direction.x);
    let corner = array<vec2<f32>, 6>(
        vec2<f32>(0.0, -1.0), vec2<f32>(1.0, -1.0), vec2<f32>(1.0, 1.0),
        vec2<f32>(0.0, -1.0), vec2<f32>(1.0, 1.0), vec2<f32>(0.0, 1.0),
    )[index];
    let end = select(clip_a, clip_b, corner.x > 0.5);
    // One pixel more than half the width: the edge fades there.
    let half_width = 0.5 * start.w * batch.scale;
    let reach = half_width + 1.0;
    let offset = normal * corner.y * reach / pixels;
    let position = vec4<f32>(end.xy + offset * end.w, end.z, end.w);
    return LinePixel(position, color, corner.y * reach, half_width);
}

@fragment
fn line_fragment(line: LinePixel) -> @location(0) vec4<f32> {
    return seen(line.color, clamp(line.half_width + 0.5 - abs(line.across), 0.0, 1.0));
}

// Discs: a square around each.

struct PointPixel {
    @builtin(position) position: vec4<f32>,
    @location(0) color: vec4<f32>,
    @location(1) @interpolate(linear) place: vec2<f32>,
    @location(2) radius: f32,
}

@vertex
fn point_vertex(
    @builtin(vertex_index) index: u32,
    @location(0) at: vec4<f32>,
    @location(1) color: vec4<f32>,
) -> PointPixel {
    let sight = at.xyz - frame.eye;
    if dot(sight, frame.forward) < frame.near {
        return PointPixel(vec4<f32>(0.0, 0.0, -1.0, 1.0), color, vec2<f32>(0.0), 0.0);
    }
    let corner = array<vec2<f32>, 6>(
        vec2<f32>(-1.0, -1.0), vec2<f32>(1.0, -1.0), vec2<f32>(1.0, 1.0),
        vec2<f32>(-1.0, -1.0), vec2<f32>(1.0, 1.0), vec2<f32>(-1.0, 1.0),
    )[index];
    let radius = 0.5 * at.w * batch.scale;
    let reach = corner * (radius + 1.0);
    let centre = clip(sight);
    let offset = reach / (0.5 * vec2<f32>(frame.width, frame.height));
    return PointPixel(vec4<f32>(centre.xy + offset * centre.w, centre.z, centre.w), color, reach, radius);
}

@fragment
fn point_fragment(point: PointPixel) -> @location(0) vec4<f32> {
    return seen(point.color, clamp(point.radius + 0.5 - length(point.place), 0.0, 1.0));
}

// Faces.

struct FacePixel {
    @builtin(position) position: vec4<f32>,
    @location(0) color: vec4<f32>,
}

@vertex
fn face_vertex(@location(0) at: vec3<f32>, @location(1) color: vec4<f32>) -> FacePixel {
    return FacePixel(clip(at - frame.eye), color);
}

@fragment
fn face_fragment(face: FacePixel) -> @location(0) vec4<f32> {
    return seen(face.color, 1.0);
}
