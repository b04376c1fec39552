// The grid's content as bricks of 2^3 voxels in a buffer, filtered here: for software rasterisers.
//
// A ray of such a rasteriser waits for memory most of the time, and its 3D textures are rows: the eight voxels of a sample
// lie in four lines of its cache, eight with features. A brick with features is one line of 64 bytes, so they lie in 3.4
// on average. texelFetch of a buffer is also a fraction of the instructions of one of a texture, which may have levels.
// On a graphics card, which tiles textures and filters them in hardware, this would be slower.
// Inputs: indirection: per macroblock the place of its first voxel, or -1 where it is empty; with an empty macroblock added
//   on every side. content: per voxel, brick by brick (BRICK_SIDE^3 of them a macroblock, x fastest), rgba and features as
//   bytes. skip_grid: see march_exact.glsl; in cubes of 4^3 cells. viewer/rendering/brick_scene.py fills all three.
// Options: INDIRECTION_SIZE: macroblocks along x and y, the border included. SKIP_SIZE: cubes of cells along x and y.
// BYTE: one level of a stored value.

layout(binding = INDIRECTION_UNIT) uniform isamplerBuffer indirection;
layout(binding = SKIP_GRID_UNIT) uniform usamplerBuffer skip_grid;
#ifdef FEATURES_STORED
layout(binding = CONTENT_UNIT) uniform usamplerBuffer content_voxels;
#else
layout(binding = CONTENT_UNIT) uniform samplerBuffer content_voxels;
#endif

#define BRICK_SIDE ((PADDED_BLOCK_SIZE + 1) / 2)
#define BRICK_STEPS ivec3(8, 8 * BRICK_SIDE, 8 * BRICK_SIDE * BRICK_SIDE)
const ivec2 INDIRECTION_SHAPE = ivec2(INDIRECTION_SIZE);
const ivec2 SKIP_SHAPE = ivec2(SKIP_SIZE);

struct Content {
    vec4 rgba;
    bool occupied;
    vec4 features;
};

#ifdef FEATURES_STORED
#define UNIT BYTE

vec4 bytes(uint word) {
    return vec4(ivec4(int(word % 256u), int((word >> 8) % 256u), int((word >> 16) % 256u), int(word >> 24)));
}

void add_voxel(inout Content content, float weight, int place) {
    uvec2 voxel = texelFetch(content_voxels, place).rg;
    content.rgba += weight * bytes(voxel.x);
    content.features += weight * bytes(voxel.y);
}
#else
#define UNIT 1.0

void add_voxel(inout Content content, float weight, int place) {
    content.rgba += weight * texelFetch(content_voxels, place);
}
#endif

// The trilinear mean of the eight voxels around a point of a padded copy. first: of its voxels in the buffer.
Content filtered_content(int first, vec3 padded) {
    vec3 low = floor(padded - 0.5);
    vec3 far = padded - 0.5 - low, close = 1.0 - far;
    // Where voxel i of an axis is: brick i / 2, and half i % 2 of it.
    ivec3 i = ivec3(low), j = i + 1;
    ivec3 halves = ivec3(1, 2, 4);
    ivec3 a = (i >> 1) * BRICK_STEPS + (i & 1) * halves;
    ivec3 b = (j >> 1) * BRICK_STEPS + (j & 1) * halves;
    vec4 square = UNIT * vec4(close.x * close.y, far.x * close.y, close.x * far.y, far.x * far.y);
    vec4 front = square * close.z, back = square * far.z;
    Content content = Content(vec4(0.0), first >= 0, vec4(0.0));
    int z = first + a.z;
    add_voxel(content, front.x, z + a.y + a.x);
    add_voxel(content, front.y, z + a.y + b.x);
    add_voxel(content, front.z, z + b.y + a.x);
    add_voxel(content, front.w, z + b.y + b.x);
    z = first + b.z;
    add_voxel(content, back.x, z + a.y + a.x);
    add_voxel(content, back.y, z + a.y + b.x);
    add_voxel(content, back.z, z + b.y + a.x);
    add_voxel(content, back.w, z + b.y + b.x);
    return content;
}

Content content_at(vec3 position, vec3 block) {
    ivec3 at = ivec3(block) + 1;
    int first = texelFetch(indirection, at.x + INDIRECTION_SHAPE.x * (at.y + INDIRECTION_SHAPE.y * at.z)).r;
    return filtered_content(first, position - block * float(BLOCK_SIZE) + 1.0);
}

Content content_of_slot(float order, vec3 padded) {
    int first = int(order) * (8 * BRICK_SIDE * BRICK_SIDE * BRICK_SIDE);
    return filtered_content(first, clamp(padded, 0.5, float(PADDED_BLOCK_SIZE) - 0.5));
}

vec4 features_of(Content content) {
    return content.features;
}

int skip_word(ivec3 cell) {
    ivec3 cube = cell >> 2, within = cell & 3;
    int place = 64 * (cube.x + SKIP_SHAPE.x * (cube.y + SKIP_SHAPE.y * cube.z)) + within.x + 4 * within.y + 16 * within.z;
    return int(texelFetch(skip_grid, place).r);
}
