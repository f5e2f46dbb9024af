// Visibility cone: the directions from which a splat is visible. Twin: authoring/cones.hidden.
in vec4 cone;  // times 127: axis in the splat's own axes, smallest cosine between it and the direction to an eye

// Return whether no eye is inside the cone. A splat without extent along an axis is not hidden.
bool hidden(vec3 mean, mat3 shape) {
    vec3 extent = vec3(dot(shape[0], shape[0]), dot(shape[1], shape[1]), dot(shape[2], shape[2]));
    if (!(min(extent.x, min(extent.y, extent.z)) > 1e-30)) return false;  // m^2; below, a float has no direction
    vec4 bounded = max(cone, -127.0);  // glTF's normalised bytes: -128 is -1 too
    vec3 axis = shape * (inversesqrt(extent) * bounded.xyz);
    float smallest = bounded.w / 127.0 - 1e-4 + frame.knobs.w;
    for (int v = 0; v < VIEWS; ++v) {
        vec3 to_eye = frame.views[v].eye.xyz - mean;
        if (!(dot(axis, to_eye) < smallest * length(axis) * length(to_eye))) return false;
    }
    return true;
}
