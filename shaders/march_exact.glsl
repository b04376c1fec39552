// Takes exactly the samples that could contribute, and jumps over all others in whole steps.
//
// Source: docs/rendering.md. Where the paper tests one byte of raw opacity before each fetch (appendix A), this reads
// one word that says how far the nearest content is, so that it both decides the fetch and gives the length of a jump,
// and needs no indirection: see viewer/rendering/skip_grid.py, which also shows why no cell without content can hide any.
// Inputs: skip_grid: per cell of the whole grid, in the low byte the Chebyshev distance in cells to the nearest one with
//   content (0: this one has), and above it a bit for each eighth of the cell that has some. Cell i spans
//   CELL * i - 0.5 to CELL * (i + 1) - 0.5. content_min, content_max: the box around all content.
// Options: CELL: voxels a side. SKIP_GRID_TEXEL: 1 / size of skip_grid. SAMPLES_A_TEST: consecutive samples to fetch once content
//   is found, before asking again.
// The phase is kept: k only ever grows by whole numbers, and a position is always computed from k afresh.
// SKIP_SLACK: a sample this close before an empty cube's far side is looked at, not jumped, whatever the rounding. The
//   other way, content reaching this far over its cell's edge stays below ALPHA_CONTRIBUTES.

#define SKIP_SLACK 1e-3

uniform vec3 content_min;
uniform vec3 content_max;
uniform usampler3D skip_grid;

int skip_word(vec3 cell) {
    return int(textureLod(skip_grid, (cell + 0.5) * SKIP_GRID_TEXEL, 0.0).r);
}

void march(Ray ray, inout Marched marched) {
    vec2 content_interval = box_interval(ray.origin, ray.inverse, content_min, content_max);
    float k = max(floor(content_interval.x), 0.0);
    float end = min(ceil(content_interval.y) + 1.0, ray.samples);
    vec3 cell_origin = (ray.origin + 0.5) / float(CELL);
    vec3 cell_step = ray.direction / float(CELL);
    vec3 cell_inverse = ray.inverse * float(CELL);
    vec3 ahead = vec3(lessThan(ray.direction, vec3(0.0)));  // from a cell's lower corner to the far side of distance 0
    while (k < end) {
        // Advance to the next sample with content around it. Two loops instead of one with a branch: a processor that
        // runs many rays in lockstep then fetches only once most of them have found something to fetch.
        while (k < end) {
            vec3 point = cell_origin + k * cell_step;
            vec3 cell = floor(point);
            vec3 within = point - cell;
            int word = skip_word(cell);
            int empty = word % 256;  // the low byte
            bool some = empty == 0;
            vec3 upper = vec3(greaterThanEqual(within, vec3(0.5)));
            int eighth = int(dot(upper, vec3(1.0, 2.0, 4.0)));
            if (some && ((word >> (8 + eighth)) & 1) != 0) break;
            // The empty cube around, (2 distance - 1) cells wide, is left after as many steps along each axis; so is an
            // empty eighth, which is a cell of half the size.
            float distance = some ? 1.0 : float(empty);
            within = some ? 2.0 * within - upper : within;
            vec3 leave = (ahead - within) * cell_inverse + distance * abs(cell_inverse);
            float steps = (some ? 0.5 : 1.0) * min(min(leave.x, leave.y), leave.z);
            k += max(ceil(steps - SKIP_SLACK), 1.0);
            marched.jumps += 1.0;
        }
        if (k >= end) break;
        for (int i = 0; i < SAMPLES_A_TEST; ++i) {
            vec3 position = ray.origin + k * ray.direction;
            vec3 block = block_of(position);
            Content content = content_at(position, block);
            marched.fetched += 1.0;
            bool marching = i == 0 || (k < end && marched.transmittance > TRANSMITTANCE_STOP);
            if (content.rgba.a > ALPHA_CONTRIBUTES && content.occupied && marching)
                composite(marched, content, ray.start + k, position, block, ray.viewdir);
            k += 1.0;
        }
        if (marched.transmittance <= TRANSMITTANCE_STOP) break;
    }
}
