// The sRGB curve (IEC 61966-2-1) and its inverse. Twins: to_linear and to_srgb of pictures.py.
vec3 linear_of(vec3 srgb) {
    return mix(pow((srgb + 0.055) / 1.055, vec3(2.4)), srgb / 12.92, lessThanEqual(srgb, vec3(0.04045)));
}

vec3 srgb_of(vec3 linear) {
    vec3 v = clamp(linear, 0.0, 1.0);
    return mix(1.055 * pow(v, vec3(1.0 / 2.4)) - 0.055, v * 12.92, lessThanEqual(v, vec3(0.0031308)));
}
