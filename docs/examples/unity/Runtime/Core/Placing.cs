using System;
using System.Collections.Generic;
using System.Numerics;

namespace GlSplat {
    public enum View { Mirror, Facing, Own }

    /// <summary>Where the avatar is shown, as on the server's page (glsplat/net/web/space/placing.js). Rows of vectors, metres.</summary>
    public sealed class Placing {
        const float MirrorM = 1.2f, FacingM = 1.8f; // from the user to the mirror; to the avatar
        public readonly View View;
        public readonly Matrix4x4 Shown = Matrix4x4.Identity; // the user's space to the shown one

        /// <param name="head">The head in the user's space.</param>
        public Placing(View view, Matrix4x4 head) {
            View = view;
            var ahead = -Level(head.M31, head.M33);
            if (ahead == Vector3.Zero) // looking down, the head's up is ahead; looking up, behind
                ahead = (head.M32 > 0 ? 1 : -1) * Level(head.M21, head.M23);
            var foot = new Vector3(head.M41, 0, head.M43);
            if (view == View.Mirror) Shown = Matrix4x4.CreateReflection(new Plane(ahead, -Vector3.Dot(ahead, foot) - MirrorM));
            if (view == View.Facing) Shown = Matrix4x4.CreateRotationY((float)Math.PI, foot + FacingM / 2 * ahead);
        }

        static Vector3 Level(float x, float z) {
            return x * x + z * z > 0.01f ? Vector3.Normalize(new Vector3(x, 0, z)) : Vector3.Zero;
        }

        /// <summary>Return the eye to send for an eye that looks at the shown space.</summary>
        public Matrix4x4 ServerEye(Matrix4x4 eye) {
            return View == View.Mirror ? eye * Shown * Matrix4x4.CreateScale(-1, 1, 1) : eye * EyeCamera.Inverse(Shown);
        }
    }

    /// <summary>An eye as it was requested: where it was in the user's space, and tangents of its picture's edges.</summary>
    public sealed class EyeCamera {
        const float MiddleM = 1, NearM = 0.3f; // height of a person's middle; nearest that a picture is put
        public readonly Matrix4x4 Eye;
        public double Depth; // metres before the eye at which its picture is shown
        readonly Vector2 _low, _high; // left and down; right and up

        public EyeCamera(double[] pose, float left, float right, float down, float up) {
            Eye = OfPose(pose);
            _low = new Vector2(left, down);
            _high = new Vector2(right, up);
        }

        /// <summary>Return the matrix of a pose [x, y, z, qx, qy, qz, qw].</summary>
        public static Matrix4x4 OfPose(double[] p) {
            var turn = Matrix4x4.CreateFromQuaternion(new Quaternion((float)p[3], (float)p[4], (float)p[5], (float)p[6]));
            turn.Translation = new Vector3((float)p[0], (float)p[1], (float)p[2]);
            return turn;
        }

        public static Matrix4x4 Inverse(Matrix4x4 m) {
            Matrix4x4.Invert(m, out var found);
            return found;
        }

        /// <summary>Return the distance along the axis of the avatar that stands under a head, metres.</summary>
        public double Distance(Placing placing, double[] head) {
            var middle = Vector3.Transform(new Vector3((float)head[0], MiddleM, (float)head[2]), placing.Shown * Inverse(Eye));
            return Math.Max(-middle.Z, NearM);
        }

        /// <summary>Return an entry of `eyes` (docs/protocol.md, section 3.1) for a picture of that size, pixels.</summary>
        public Dictionary<string, object> Fields(Placing placing, double width, double height) {
            var m = Inverse(placing.ServerEye(Eye));
            var view = new double[] { m.M11, m.M21, m.M31, m.M41, -m.M12, -m.M22, -m.M32, -m.M42, -m.M13, -m.M23, -m.M33, -m.M43, 0, 0, 0, 1 };
            double fx = width / (_high.X - _low.X), fy = height / (_high.Y - _low.Y);
            return new Dictionary<string, object> { { "viewmat", view }, { "K", new[] { fx, fy, -_low.X * fx, _high.Y * fy } } };
        }

        /// <summary>Return a point of the picture in the user's space: shares of width and height from the upper left, metres.</summary>
        public double[] Point(double u, double v) {
            var at = new Vector2((float)u, (float)(1 - v)) * (_high - _low) + _low;
            var point = Vector3.Transform(new Vector3(at, -1) * (float)Depth, Eye);
            return new double[] { point.X, point.Y, point.Z };
        }
    }
}
