// Where a quad ends: where alpha = opacity exp(-d^2/2) falls below 1/255. Twin: reference.project.
const float ALPHA_MIN = 1.0 / 255.0;
const float ALPHA_MAX = 0.99;

float extent_of(float alpha) {  // standard deviations; call with alpha >= 1/255
    return min(frame.knobs.y, sqrt(max(2.0 * log(alpha * 255.0), 0.0)));
}
