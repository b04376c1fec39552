// Rays through contracted space: straight piece by piece (scenepack/contraction.py; docs/rendering.md, "Contracted packs").
//
// Notation: x = origin + t direction is a ray of space from where it begins, u the same point contracted; both in units of R,
// about the middle of the inner cube. w = max(|x|∞, 1) is the largest of seven linear functions of t: x, -x and 1. While one of
// them leads, u runs straight; the next to lead is that of the steeper ones that crosses first. s: length of the path from where
// it begins.
// Inputs: contraction_centre, contraction_radius (voxels; composite.glsl).

#define MOST_PIECES 7
#define NEVER 1e30

// A path, at one of its pieces.
struct Path {
    vec3 origin;
    vec3 direction;
    vec3 outward;  // what leads: the unit vector through a side of the cube; zero for 1
    vec3 next;     // what leads the next piece
    vec2 ends;     // t where the piece begins and ends; NEVER at infinity
    vec2 lengths;  // s there
    float width;   // w where it begins
    float rate;    // dw/dt
    vec3 moved;    // w^2 du/dt
};

// Goes to the piece that `outward` leads, from t and s on.
void lead(inout Path path, vec3 outward, float t, float s) {
    vec3 o = path.origin, d = path.direction;
    bool inner = outward == vec3(0.0);
    float value = inner ? 1.0 : dot(outward, o);
    float rate = dot(outward, d);
    path.outward = outward;
    path.width = value + rate * t;
    path.rate = rate;
    path.moved = inner ? d : mix(d * value - o * rate, outward * rate, abs(outward));
    vec3 rise = d - rate, fall = -d - rate;  // how much steeper x and -x are
    vec3 up = mix(vec3(NEVER), (value - o) / rise, greaterThan(rise, vec3(0.0)));
    vec3 down = mix(vec3(NEVER), (value + o) / fall, greaterThan(fall, vec3(0.0)));
    vec3 first = min(up, down);
    float crossing = min(min(first.x, first.y), first.z);
    path.next = crossing == first.x   ? vec3(up.x <= down.x ? 1.0 : -1.0, 0.0, 0.0)
                : crossing == first.y ? vec3(0.0, up.y <= down.y ? 1.0 : -1.0, 0.0)
                                      : vec3(0.0, 0.0, up.z <= down.z ? 1.0 : -1.0);
    if (rate < 0.0 && (1.0 - value) / rate <= crossing) {
        crossing = (1.0 - value) / rate;
        path.next = vec3(0.0);
    }
    path.ends = vec2(t, max(crossing, t));
    float lasts = path.ends.y - t;
    float grown = crossing < NEVER ? lasts / (path.width * (path.width + rate * lasts)) : 1.0 / (path.width * rate);
    path.lengths = vec2(s, s + length(path.moved) * grown);
}

Path path_of(Ray ray) {
    Path path;
    path.origin = (ray.origin - contraction_centre) / contraction_radius;
    path.direction = ray.direction;
    lead(path, outward_at(path.origin), 0.0, 0.0);
    return path;
}

// Whether there is another piece, and goes to it.
bool advance(inout Path path) {
    if (path.ends.y >= NEVER) return false;
    lead(path, path.next, path.ends.y, path.lengths.y);
    return true;
}

// The samples of a piece: s = 0.5 + k, of the whole path, as far as they lie in the piece and in the box. Voxels.
Ray ray_of(Path path, vec3 viewdir) {
    vec3 x = path.origin + path.ends.x * path.direction;
    vec3 u = mix(x / path.width, path.outward * (2.0 - 1.0 / path.width), abs(path.outward));
    vec2 lengths = contraction_radius * path.lengths;
    Ray ray;
    ray.viewdir = viewdir;
    ray.direction = without_zeros(normalize(path.moved));
    ray.inverse = 1.0 / ray.direction;
    ray.origin = contraction_centre + contraction_radius * u;
    vec2 inside = box_interval(ray.origin, ray.inverse, box_min, box_max);
    ray.start = ceil(lengths.x + max(inside.x, 0.0) - 0.5) + 0.5;
    ray.length = min(lengths.x + inside.y, lengths.y) - ray.start;
    ray.samples = max(ceil(ray.length), 0.0);
    ray.origin += (ray.start - lengths.x) * ray.direction;
    return ray;
}

void march_path(Ray ray, inout Marched marched) {
    if (ray.length < 0.0) return;
    Path path = path_of(ray);
    for (int piece = 0; piece < MOST_PIECES && marched.transmittance > TRANSMITTANCE_STOP; ++piece) {
        march(ray_of(path, ray.viewdir), marched);
        if (!advance(path)) break;
    }
}

// The distance from the ray's beginning, in voxels of space, at which its path has the length s (voxels of contracted space).
float distance_at(Ray ray, float s) {
    Path path = path_of(ray);
    s /= contraction_radius;
    for (int piece = 1; piece < MOST_PIECES && s >= path.lengths.y; ++piece)
        if (!advance(path)) break;
    float speed = length(path.moved), beyond = s - path.lengths.x;
    float left = max(speed - beyond * path.width * path.rate, 1e-6 * speed);
    return contraction_radius * (path.ends.x + beyond * path.width * path.width / left);
}
