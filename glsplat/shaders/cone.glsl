// Visibility cone: the directions from which a splat was seen at all. Twin: skinning/cones.hidden.
in vec4 cone;  // times 127: axis in the splat's own axes, smallest cosine between it and the way to an eye

// No eye is inside the cone. What cannot be told (a splat without extent in some direction) is not hidden.
bool hidden(vec3 mean, mat3 shape) {
    vec3 axis = mat3(normalize(shape[0]), normalize(shape[1]), normalize(shape[2])) * cone.xyz;
    float smallest = cone.w / 127.0 - 1e-4 + frame.knobs.w;
    for (int v = 0; v < VIEWS; ++v) {
        vec3 to_eye = frame.views[v].eye.xyz - mean;
        if (!(dot(axis, to_eye) < smallest * length(axis) * length(to_eye))) return false;
    }
    return true;
}
