// A look: exposure, white balance and saturation, in linear light. For the eye alone: what is measured has none.
//
// Inputs: look_gain: factors of red, green and blue; look_saturation: 0 for grey, 1 for colours as they are.
#define LUMINANCE vec3(0.2126, 0.7152, 0.0722)  // of linear sRGB

uniform vec3 look_gain;
uniform float look_saturation;

vec3 look(vec3 colour) {
    vec3 light = mix(colour / 12.92, pow((colour + 0.055) / 1.055, vec3(2.4)), greaterThan(colour, vec3(0.04045)));
    light *= look_gain;
    light = max(mix(vec3(dot(light, LUMINANCE)), light, look_saturation), 0.0);
    return mix(12.92 * light, 1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055, greaterThan(light, vec3(0.0031308)));
}

// The same of what is shown of a ray: of the scene, not of the background that lies behind it.
vec3 with_look(vec3 shown, vec3 behind, float alpha) {
    if (alpha <= 0.0) return shown;
    return alpha * look(max((clamp(shown, 0.0, 1.0) - behind) / alpha, 0.0)) + behind;
}
