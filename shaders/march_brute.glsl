// Takes every sample, skipping nothing: what `exact` must equal. For tests.
//
// Source: docs/rendering.md, "Samples". Inputs: ray.glsl, grid.glsl, composite.glsl.

Marched march(Ray ray) {
    Marched marched = nothing_yet();
    for (float k = 0.0; k < ray.samples; k += 1.0) {
        vec3 position = ray.origin + k * ray.direction;
        vec3 block = block_of(position);
        uvec4 entry = indirection_of(block);
        if (entry.a != 0u) continue;
        vec3 coordinates = atlas_coordinates(entry, position - block * float(BLOCK_SIZE));
        vec4 rgba = textureLod(atlas_rgba, coordinates, 0.0);
#ifdef COUNT_COST
        marched.fetched += 1.0;
#endif
        if (rgba.a > ALPHA_CONTRIBUTES) {
            composite(marched, rgba, coordinates, ray.start + k, block, ray.viewdir);
            if (marched.transmittance <= TRANSMITTANCE_STOP) break;
        }
    }
    return marched;
}
