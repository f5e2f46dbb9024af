// Opacity compensation for culled hidden splats, which shone through the splats in front: behind alpha A they add about
// A^3 of the same colour. Nearly opaque pixels become opaque, thin ones stay thin. Twin: reference.lifted.
vec4 lifted(vec4 pixel, vec3 background) {
    float clear = 1.0 - pixel.a;
    float more = pixel.a * pixel.a * clear;  // A^3 (1 - A) / A
    return pixel * (1.0 + more) - vec4(more * background, 0.0);  // in this form infinity stays infinity
}
