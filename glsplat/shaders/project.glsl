// EWA projection of one splat into one view, culling included. Twin: reference.project.
struct Footprint {
    vec2 centre;   // pixels
    vec3 cholesky; // l00, l10, l11 of the dilated covariance (px); unlike eigenvectors, it has no degenerate case
    float alpha;   // opacity, compensated under ANTIALIAS
    float z;       // of the mean, in metres
};

// Reason of culling; 0: visible. Twin: CULL_REASONS in renderer/sort.py.
const uint VISIBLE = 0u;
const uint OUT_OF_RANGE = 1u;
const uint TRANSPARENT = 2u;
const uint DEGENERATE = 3u;
const uint OUTSIDE = 4u;
const uint HIDDEN = 5u;

uint project(vec3 mean, mat3 shape, float opacity, int view, out Footprint foot) {
#if ANTIALIAS == 2
    bool compensated = opacity < 0.0;
    opacity = abs(opacity);
#else
    const bool compensated = true;
#endif
    View v = frame.views[view];
    vec3 p = vec3(dot(v.rows[0].xyz, mean), dot(v.rows[1].xyz, mean), dot(v.rows[2].xyz, mean))
        + vec3(v.rows[0].w, v.rows[1].w, v.rows[2].w);
    foot.centre = vec2(0.0);
    foot.cholesky = vec3(0.0);
    foot.alpha = min(opacity, 1.0);
    foot.z = p.z;
    if (!(p.z > v.range.x && p.z < v.range.y)) return OUT_OF_RANGE;

    // J W M row by row: (f / z) (row_xy - clamp(xy / z) row_z)
    vec3 row_z = v.rows[2].xyz * shape;
    vec2 slope = clamp(p.xy / p.z, v.limits.xz, v.limits.yw);
    vec3 t0 = (v.intrinsics.x / p.z) * (v.rows[0].xyz * shape - slope.x * row_z);
    vec3 t1 = (v.intrinsics.y / p.z) * (v.rows[1].xyz * shape - slope.y * row_z);

    // det(T T^T) = |t0 x t1|^2 (Lagrange): positive terms only; a c - b^2 cancels for needles.
    // Dividing by a before squaring avoids overflow below 1e18 px.
    float eps = frame.knobs.x;
    float a = dot(t0, t0) + eps;
    float l00 = sqrt(a);
    vec3 normal = cross(t0 / l00, t1);
    float area = dot(normal, normal);
    float dilated = area + eps * (dot(t0, t0) + dot(t1, t1) + eps) / a;
    float l10 = dot(t0, t1) / l00;
    foot.cholesky = vec3(l00, l10, sqrt(dilated));
    foot.centre = v.intrinsics.xy * (p.xy / p.z) + v.intrinsics.zw;
#if ANTIALIAS
    if (compensated) foot.alpha *= sqrt(max(area / dilated, 2.5e-5));
#endif
    if (!(foot.alpha >= ALPHA_MIN)) return TRANSPARENT;
    if (!(l00 > 0.0 && l00 < 1e18 && dilated > 0.0 && dilated < 1e36)) return DEGENERATE;
    vec2 reach = extent_of(foot.alpha) * vec2(l00, length(foot.cholesky.yz));
    bool inside = all(greaterThan(foot.centre + reach, vec2(0.0))) && all(lessThan(foot.centre - reach, frame.size.xy));
    return inside ? VISIBLE : OUTSIDE;
}
