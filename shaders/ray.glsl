// From a pixel to its ray through the grid's box.
//
// Inputs: viewport_origin, picture_size (pixels); intrinsics fx, fy, cx, cy (pixels, y down);
//   grid_R_camera (camera axes: x right, y up, z back); camera_position; near_plane (along the optical axis), ray_near (along
//   the ray): nothing nearer is seen;
//   box_min, box_max: the grid, or the part of it that a crop box leaves;
//   training_R_camera: for the view direction of the view MLP.
//   ORTHOGRAPHIC: parallel rays; fx and fy are pixels per voxel. Never together with NDC or DISTORTION.
//   NDC: training_camera, ndc_scale, voxel_R_ndc, voxel_t_ndc; see ndc_ray. DISTORTION: distortion, lens_reach; see undistorted.
//   CONTRACTED: the ray is that of space; path.glsl makes rays of the grid of it, one a piece.
#ifndef TINY
#define TINY 1e-8
#endif

uniform vec2 viewport_origin;
uniform vec2 picture_size;
uniform vec4 intrinsics;
uniform mat3 grid_R_camera;
uniform vec3 camera_position;
uniform float near_plane;
uniform float ray_near;
uniform vec3 box_min;
uniform vec3 box_max;
uniform mat3 training_R_camera;

struct Ray {
    vec3 origin;     // of sample 0; sample k is at origin + k * direction
    vec3 direction;  // unit length, no component zero
    vec3 inverse;    // 1 / direction
    float length;    // from sample 0 to where the ray leaves the box; may be negative
    float samples;   // how many lie in the box
    float start;     // distance from the ray's beginning to sample 0
    vec3 viewdir;    // unit view direction in the training frame
};

// Distances at which origin + t * direction enters and leaves a box.
vec2 box_interval(vec3 origin, vec3 inverse, vec3 low, vec3 high) {
    vec3 a = (low - origin) * inverse;
    vec3 b = (high - origin) * inverse;
    vec3 enter = min(a, b);
    vec3 leave = max(a, b);
    return vec2(max(max(enter.x, enter.y), enter.z), min(min(leave.x, leave.y), leave.z));
}

vec3 without_zeros(vec3 direction) {
    return mix(direction, vec3(TINY), lessThan(abs(direction), vec3(TINY)));
}

#ifdef NDC
// Forward-facing scenes are stored in normalised device coordinates (NeRF, appendix C): the ray is moved to the plane
// z = -n of the training frame (n = NDC_NEAR) and warped, so that it runs straight through the cube [-1, 1]^3.
uniform vec3 training_camera;  // the camera's position in the training frame, before the warp; scene units
uniform vec2 ndc_scale;        // 2 focal / width, 2 focal / height of the photographs
uniform mat3 voxel_R_ndc;      // NDC to voxels: rotation, reflection and scale ...
uniform vec3 voxel_t_ndc;      // ... and shift

// Returns false where the ray runs away from the scene. `nearest`: distance along the unwarped ray to start from.
bool ndc_ray(vec3 direction, float nearest, out vec3 origin, out vec3 warped, out float first) {
    if (direction.z > -TINY) return false;
    float shift = -(NDC_NEAR + training_camera.z) / direction.z;
    vec3 o = training_camera + shift * direction;  // o.z == -NDC_NEAR
    vec3 slope = direction / direction.z;
    origin = vec3(-ndc_scale * o.xy / o.z, 1.0 + 2.0 * NDC_NEAR / o.z);
    warped = vec3(-ndc_scale * (slope.xy - o.xy / o.z), -2.0 * NDC_NEAR / o.z);
    origin = voxel_R_ndc * origin + voxel_t_ndc;
    warped = voxel_R_ndc * warped;
    // A point s further along is at s d.z / (o.z + s d.z) of `warped`. It only counts once past the plane.
    float beyond = max(nearest - shift, 0.0) * direction.z;
    first = length(warped) * beyond / (o.z + beyond);
    warped = normalize(warped);
    return true;
}
#endif

#ifdef DISTORTION
uniform vec4 distortion;   // k1, k2, p1, p2 of OpenCV's model, on image coordinates with y down
uniform float lens_reach;  // how far from the axis the model holds, image coordinates; see viewer/rendering/ray_frame.py
#define NEWTON_STEPS 6
#define LENS_TOLERANCE 1e-3  // image coordinates

// The image coordinates that the lens moved to `seen`: the inverse of
//   seen = p (1 + k1 r^2 + k2 r^4) + 2 (p1, p2) p.x p.y + (p2, p1) (r^2 + 2 p^2),  r = |p|,  by Newton's method.
// `sees`: false where there are none. Beyond a photograph's edges the polynomial may fold over, and names no ray there.
vec2 undistorted(vec2 seen, out bool sees) {
    vec2 k = distortion.xy, s = distortion.zw;
    vec2 p = seen;
    vec2 error = vec2(0.0);
    for (int i = 0; i < NEWTON_STEPS; ++i) {
        float r2 = dot(p, p);
        float radial = 1.0 + r2 * (k.x + r2 * k.y);
        float slope = 2.0 * (k.x + 2.0 * r2 * k.y);
        error = p * radial + 2.0 * s * p.x * p.y + s.yx * (r2 + 2.0 * p * p) - seen;
        float across = slope * p.x * p.y + 2.0 * dot(s, p);
        vec2 along = radial + slope * p * p + 6.0 * s.yx * p + 2.0 * s * p.yx;
        float determinant = along.x * along.y - across * across;
        if (abs(determinant) > 1e-6) p -= (along.yx * error - across * error.yx) / determinant;
    }
    sees = dot(p, p) < lens_reach * lens_reach && dot(error, error) < LENS_TOLERANCE * LENS_TOLERANCE;
    return p;
}
#endif

Ray camera_ray(vec2 fragment) {
    Ray ray;
    vec2 pixel = fragment - viewport_origin;
    pixel.y = picture_size.y - pixel.y;
    vec2 image = (pixel - intrinsics.zw) / intrinsics.xy;
    bool runs = true;
#ifdef DISTORTION
    image = undistorted(image, runs);
#endif
#ifdef ORTHOGRAPHIC
    vec3 in_camera = vec3(0.0, 0.0, -1.0);
#else
    vec3 in_camera = normalize(vec3(image.x, -image.y, -1.0));
#endif
    float first = max(near_plane / -in_camera.z, ray_near);
    ray.viewdir = normalize(training_R_camera * in_camera);
    vec3 origin = camera_position;
#ifdef ORTHOGRAPHIC
    origin += grid_R_camera * vec3(image.x, -image.y, 0.0);
#endif
    vec3 direction = normalize(grid_R_camera * in_camera);
#ifdef NDC
    runs = ndc_ray(ray.viewdir, first, origin, direction, first) && runs;
#endif
    ray.direction = without_zeros(direction);
    ray.inverse = 1.0 / ray.direction;
#ifdef CONTRACTED
    ray.start = first;
    ray.length = runs ? 0.0 : -1.0;
    ray.samples = 0.0;
#else
    vec2 inside = box_interval(origin, ray.inverse, box_min, box_max);
    ray.start = max(inside.x, first) + 0.5;
    ray.length = runs ? inside.y - ray.start : -1.0;
    ray.samples = max(ceil(ray.length), 0.0);
#endif
    ray.origin = origin + ray.start * ray.direction;
    return ray;
}
