// From a pixel to its ray through the grid's box.
//
// Inputs: viewport_origin, picture_size (pixels); intrinsics fx, fy, cx, cy (pixels, y down);
//   grid_R_camera (camera axes: x right, y up, z back); camera_position; near_plane (along the optical axis), ray_near (along
//   the ray): nothing nearer is seen;
//   box_min, box_max: the grid, or the part of it that a crop box leaves;
//   training_R_camera: for the view direction of the view MLP.
//   ORTHOGRAPHIC: parallel rays; fx and fy are pixels per voxel. Never together with NDC or DISTORTION.
//   DISTORTION: lens, lens_reach; see undistorted. eye_offset (voxels): of a panorama, how far to the right of the camera each ray
//   begins, across the direction of its column, so that two such pictures are a stereo pair in all directions.
//   NDC: training_camera, ndc_scale, voxel_R_ndc, voxel_t_ndc; see ndc_ray.
//   CONTRACTED: the ray is that of space; path.glsl makes rays of the grid of it, one a piece.
#define TINY 1e-8

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
// A lens as training/scenes/lens.py has it: k1, k2, p1, p2; k3, k4, q1, q2; q3, s1, s2 and the projection. Image coordinates, y down.
uniform vec4 lens[3];
uniform float eye_offset;
uniform float lens_reach;  // how far from the axis the model holds, image coordinates; see viewer/rendering/ray_frame.py
#define LENS_FISHEYE 1.0
#define LENS_EQUIRECTANGULAR 2.0
#define POLE 1.5707964  // of a panorama, image coordinates, as in lens.py
#define NEWTON_STEPS 6
#define LENS_TOLERANCE 1e-3  // image coordinates

// The image coordinates that the lens moved to `seen`: the inverse, by Newton's method, of
//   seen = p radial + 2 (p1, p2) p.x p.y + (p2, p1) (r^2 + 2 p^2) + (s1, s2) r^2,  r = |p|,
//   radial = (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) / (1 + q1 r^2 + q2 r^4 + q3 r^6).
// `sees`: false where there are none. Beyond a photograph's edges the polynomial may fold over, and names no ray there.
vec2 undistorted(vec2 seen, out bool sees) {
    vec4 k = vec4(lens[0].xy, lens[1].xy);
    vec3 q = vec3(lens[1].zw, lens[2].x);
    vec2 s = lens[0].zw, prism = lens[2].yz;
    vec2 p = seen;
    vec2 error = vec2(0.0);
    for (int i = 0; i < NEWTON_STEPS; ++i) {
        float r2 = dot(p, p);
        float under = 1.0 + r2 * (q.x + r2 * (q.y + r2 * q.z));
        float radial = (1.0 + r2 * (k.x + r2 * (k.y + r2 * (k.z + r2 * k.w)))) / under;
        float slope = k.x + r2 * (2.0 * k.y + r2 * (3.0 * k.z + r2 * 4.0 * k.w));
        slope = 2.0 * (slope - radial * (q.x + r2 * (2.0 * q.y + r2 * 3.0 * q.z))) / under;
        error = p * radial + 2.0 * s * p.x * p.y + s.yx * (r2 + 2.0 * p * p) + prism * r2 - seen;
        vec2 across = slope * p.x * p.y + 2.0 * dot(s, p) + 2.0 * prism * p.yx;  // du/db, dv/da
        vec2 along = radial + slope * p * p + 6.0 * s.yx * p + 2.0 * s * p.yx + 2.0 * prism * p;
        float determinant = along.x * along.y - across.x * across.y;
        if (abs(determinant) > 1e-6) p -= (along.yx * error - across * error.yx) / determinant;
    }
    sees = dot(p, p) < lens_reach * lens_reach && dot(error, error) < LENS_TOLERANCE * LENS_TOLERANCE;
    return p;
}

// The direction, in camera axes, of image coordinates without distortion.
vec3 through_lens(vec2 p) {
    if (lens[2].w == LENS_FISHEYE) {
        float angle = length(p);
        return vec3((angle > TINY ? sin(angle) / angle : 1.0) * vec2(p.x, -p.y), -cos(angle));
    }
    if (lens[2].w == LENS_EQUIRECTANGULAR) return vec3(sin(p.x) * cos(p.y), -sin(p.y), -cos(p.x) * cos(p.y));
    return normalize(vec3(p.x, -p.y, -1.0));
}
#endif

Ray camera_ray(vec2 fragment) {
    Ray ray;
    vec2 pixel = fragment - viewport_origin;
    pixel.y = picture_size.y - pixel.y;
    vec2 image = (pixel - intrinsics.zw) / intrinsics.xy;
    bool runs = true;
    vec3 origin = camera_position;
#ifdef DISTORTION
    image = undistorted(image, runs);
    vec3 in_camera = through_lens(image);
    if (lens[2].w == LENS_EQUIRECTANGULAR) {
        runs = runs && abs(image.y) <= POLE;
        origin += grid_R_camera * (eye_offset * vec3(cos(image.x), 0.0, sin(image.x)));
    }
#elif defined(ORTHOGRAPHIC)
    vec3 in_camera = vec3(0.0, 0.0, -1.0);
    origin += grid_R_camera * vec3(image.x, -image.y, 0.0);
#else
    vec3 in_camera = normalize(vec3(image.x, -image.y, -1.0));
#endif
    float first = max(near_plane / max(-in_camera.z, TINY), ray_near);
    ray.viewdir = normalize(training_R_camera * in_camera);
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
