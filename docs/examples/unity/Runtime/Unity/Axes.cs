using System;
using UnityEngine;

namespace GlSplat {
    /// <summary>
    /// The one place where Unity's axes and the protocol's meet. Both are in metres, y up.
    ///
    ///              Unity (left-handed)   protocol, OpenXR (right-handed)
    ///   right      +x                    +x
    ///   ahead      +z                    -z
    ///   position   (x, y, z)             (x, y, -z)
    ///   rotation   (x, y, z, w)          (-x, -y, z, w)
    ///   projection m00 m02 m11 m12       tangents: left, right (m02 -+ 1) / m00; down, up (m12 -+ 1) / m11
    /// </summary>
    static class Axes {
        public static double[] Direction(Vector3 v) { return new[] { Round(v.x), Round(v.y), Round(-v.z) }; }

        /// <summary>Return a pose as [x, y, z, qx, qy, qz, qw].</summary>
        public static double[] Pose(Vector3 p, Quaternion q) {
            return new[] { Round(p.x), Round(p.y), Round(-p.z), Round(-q.x), Round(-q.y), Round(q.z), Round(q.w) };
        }

        public static Vector3 Point(double[] p) { return new Vector3((float)p[0], (float)p[1], (float)-p[2]); }

        public static EyeCamera Camera(double[] pose, Matrix4x4 m) {
            return new EyeCamera(pose, (m.m02 - 1) / m.m00, (m.m02 + 1) / m.m00, (m.m12 - 1) / m.m11, (m.m12 + 1) / m.m11);
        }

        static double Round(float value) { return Math.Round(value, 6); } // short messages
    }
}
