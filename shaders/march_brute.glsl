// Takes every sample, skipping nothing: what `exact` must equal. For tests.
//
// Source: docs/rendering.md, "Samples". Inputs: ray.glsl, grid.glsl, composite.glsl.

void march(Ray ray, inout Marched marched) {
    for (float k = 0.0; k < ray.samples; k += 1.0) {
        vec3 position = ray.origin + k * ray.direction;
        vec3 block = block_of(position);
        Content content = content_at(position, block);
        if (!content.occupied) continue;
        marched.fetched += 1.0;
        if (content.rgba.a > ALPHA_CONTRIBUTES) {
            composite(marched, content, ray.start + k, position, block, ray.viewdir);
            if (marched.transmittance <= TRANSMITTANCE_STOP) break;
        }
    }
}
