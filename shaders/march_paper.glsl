// The paper's marcher, literally: the baseline that `exact` is measured against. Keep it honest and unoptimised.
//
// Source: SNeRG paper, section 5.2 and appendix A. Empty macroblocks are left through a ray-box test, and the phase of
// the samples begins anew behind them; a nearest fetch of raw opacity decides whether a sample is looked at, so the
// half voxel around content that trilinear interpolation would still see is missed. Opacity, colour and features are
// three textures. The view MLP is in view_mlp_textures.glsl.
// Inputs: atlas_alpha_nearest: the same texture as atlas_alpha, unfiltered.

uniform sampler3D atlas_alpha_nearest;

void march(Ray ray, inout Marched marched) {
    float t = 0.0;  // from sample 0, where the ray has entered the grid by half a voxel
    while (t < ray.length && marched.transmittance > TRANSMITTANCE_STOP) {
        vec3 position = ray.origin + t * ray.direction;
        vec3 block = block_of(position);
        vec3 corner = block * float(BLOCK_SIZE);
        uvec4 entry = indirection_of(block);
        if (entry.a != 0u) {
            t = max(t, box_interval(ray.origin, ray.inverse, corner, corner + float(BLOCK_SIZE)).y) + 0.5;
            marched.jumps += 1.0;
            continue;
        }
        vec3 coordinates = atlas_coordinates(entry, position - corner);
        if (textureLod(atlas_alpha_nearest, coordinates, 0.0).r > 0.0) {
            Content content = Content(fetch_rgba(coordinates), true, coordinates);
            composite(marched, content, ray.start + t, position, block, ray.viewdir);
            marched.fetched += 1.0;
        }
        t += 1.0;
    }
}
