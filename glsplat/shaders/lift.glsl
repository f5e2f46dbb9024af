// What was left out behind opaque splats still shone through them. Behind alpha A there was about A^3 more of the same
// colour: opaque pixels become opaque again, thin ones stay thin. Twin: reference.lifted.
vec4 lifted(vec4 pixel, vec3 background) {
    float clear = 1.0 - pixel.a;
    float more = pixel.a * pixel.a * clear;  // A^3 (1 - A) / A
    return pixel * (1.0 + more) - vec4(more * background, 0.0);  // this way infinity stays infinity
}
