// Linear blend skinning from the bone texture (RGBA32F, 3 x J texels: row r of bone j's 3x4 matrix at (r, j)).
// Twins: reference.skin, reference.blended_rotations.
uniform sampler2D bones;

#if INFLUENCES == 1
in uint joints0;
in float weights0;
#elif INFLUENCES == 2
in uvec2 joints0;
in vec2 weights0;
#else
in uvec4 joints0;
in vec4 weights0;
#endif
#if INFLUENCES == 8
in uvec4 joints1;
in vec4 weights1;
#endif

struct Affine { vec4 x, y, z; };  // rows of a 3x4 matrix

Affine bone(uint joint) {
    int j = int(joint);
    return Affine(texelFetch(bones, ivec2(0, j), 0), texelFetch(bones, ivec2(1, j), 0), texelFetch(bones, ivec2(2, j), 0));
}

void add(inout Affine sum, uint joint, float weight) {
    Affine b = bone(joint);
    sum.x += weight * b.x;
    sum.y += weight * b.y;
    sum.z += weight * b.z;
}

Affine blended_bones() {
    Affine sum = Affine(vec4(0.0), vec4(0.0), vec4(0.0));
#if INFLUENCES == 1
    add(sum, joints0, weights0);
#else
    for (int k = 0; k < min(INFLUENCES, 4); ++k) add(sum, joints0[k], weights0[k]);
#endif
#if INFLUENCES == 8
    for (int k = 0; k < 4; ++k) add(sum, joints1[k], weights1[k]);
#endif
    return sum;
}

Affine anchor_bone() {  // slot 0: Skin.anchored
#if INFLUENCES == 1
    return bone(joints0);
#else
    return bone(joints0.x);
#endif
}
