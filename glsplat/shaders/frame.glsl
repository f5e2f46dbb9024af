// The uniform block of a frame. Twin: frame_dtype in renderer/frame_block.py (a test compares the sizes).
struct View {
    vec4 rows[3];     // camera from scene, rows of [R | t], relative to the scene's origin (composed in float64)
    vec4 intrinsics;  // fx, fy, cx, cy in pixels
    vec4 limits;      // smallest and largest x/z, then y/z, for the Jacobian (gsplat: 15 % beyond the image)
    vec4 eye;         // xyz: the eye in scene coordinates
    vec4 background;  // rgb
    vec4 range;       // near, far
};

layout(std140) uniform Frame {
    View views[VIEWS];
    vec4 sort_row;  // third row of the sorting camera: z = dot(xyz, mean) + w
    vec4 size;      // width, height in pixels, 2 / width, 2 / height
    vec4 knobs;     // eps2d (px^2), max_sigma, unused, cull_margin
} frame;
