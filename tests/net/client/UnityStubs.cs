// The few types of Unity that the client uses, as far as its tests need them: names and signatures are Unity's.
using System;
using System.Collections.Generic;
using System.IO;

namespace UnityEngine {
    public struct Vector3 {
        public float x, y, z;
        public static readonly Vector3 zero = new Vector3(0, 0, 0), one = new Vector3(1, 1, 1);
        public static readonly Vector3 right = new Vector3(1, 0, 0), up = new Vector3(0, 1, 0), forward = new Vector3(0, 0, 1);
        public Vector3(float x, float y, float z) { this.x = x; this.y = y; this.z = z; }
        public static Vector3 operator +(Vector3 a, Vector3 b) { return new Vector3(a.x + b.x, a.y + b.y, a.z + b.z); }
        public static Vector3 operator -(Vector3 a, Vector3 b) { return new Vector3(a.x - b.x, a.y - b.y, a.z - b.z); }
        public static Vector3 operator -(Vector3 a) { return zero - a; }
        public static Vector3 operator *(float k, Vector3 a) { return new Vector3(k * a.x, k * a.y, k * a.z); }
        public static float Dot(Vector3 a, Vector3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
        public static Vector3 Cross(Vector3 a, Vector3 b) { return new Vector3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x); }
        public static Vector3 ProjectOnPlane(Vector3 v, Vector3 normal) { return v - Dot(v, normal) * normal; }
    }

    public struct Vector4 {
        public float x, y, z, w;
        public static implicit operator Vector4(Vector3 v) { return new Vector4 { x = v.x, y = v.y, z = v.z }; }
    }

    public struct Quaternion {
        public float x, y, z, w;
        public static readonly Quaternion identity = new Quaternion(0, 0, 0, 1);
        public Quaternion(float x, float y, float z, float w) { this.x = x; this.y = y; this.z = z; this.w = w; }
        public static Quaternion Inverse(Quaternion q) { return new Quaternion(-q.x, -q.y, -q.z, q.w); }
        public static Quaternion operator *(Quaternion a, Quaternion b) {
            Vector3 u = new Vector3(a.x, a.y, a.z), v = new Vector3(b.x, b.y, b.z), s = a.w * v + b.w * u + Vector3.Cross(u, v);
            return new Quaternion(s.x, s.y, s.z, a.w * b.w - Vector3.Dot(u, v));
        }
        public static Vector3 operator *(Quaternion q, Vector3 v) {
            var turned = q * new Quaternion(v.x, v.y, v.z, 0) * Inverse(q);
            return new Vector3(turned.x, turned.y, turned.z);
        }
        public static Quaternion LookRotation(Vector3 forward) { // level ones
            double half = Math.Atan2(forward.x, forward.z) / 2;
            return new Quaternion(0, (float)Math.Sin(half), 0, (float)Math.Cos(half));
        }
    }

    public struct Matrix4x4 { public float m00, m02, m11, m12; }
    public struct Pose { public Vector3 position; public Quaternion rotation; }
    public struct Bounds { public Bounds(Vector3 center, Vector3 size) { } }

    public class Object {
        public static void Destroy(Object one) { }
        public static implicit operator bool(Object one) { return one != null; }
    }
    public class Component : Object {
        public readonly Transform transform;
        public readonly GameObject gameObject = new GameObject();
        public Component() { transform = this as Transform ?? new Transform(); }
    }
    public class MonoBehaviour : Component { }
    public class GameObject : Object { public int layer; }
    public class Transform : Component {
        public Transform parent;
        public Vector3 position;
        public Quaternion rotation = Quaternion.identity;
        public Vector3 forward { get { return rotation * Vector3.forward; } }
        public Matrix4x4 localToWorldMatrix { get { return new Matrix4x4(); } }
        public Vector3 TransformPoint(Vector3 p) { return position + rotation * p; }
        public Vector3 InverseTransformPoint(Vector3 p) { return Quaternion.Inverse(rotation) * (p - position); }
        public void SetPositionAndRotation(Vector3 p, Quaternion q) { position = p; rotation = q; }
    }
    public class Camera : Component {
        public enum StereoscopicEye { Left, Right }
        public static Camera main;
        public bool stereoEnabled;
        public Matrix4x4 projectionMatrix;
        public readonly Matrix4x4[] stereo = new Matrix4x4[2];
        public Matrix4x4 GetStereoProjectionMatrix(StereoscopicEye eye) { return stereo[(int)eye]; }
    }
    public class TextMesh : Component { public string text; }
    public class TooltipAttribute : Attribute { public TooltipAttribute(string text) { } }
    public class Shader : Object { }
    public class Texture : Object { }
    public class Texture2D : Texture { public byte[] jpeg; }
    public class Mesh : Object { public Vector3[] vertices; public int[] triangles; public Bounds bounds; }
    public class Material : Object {
        public static Material last;
        public readonly Dictionary<string, object> set = new Dictionary<string, object>();
        public Material(Shader shader) { last = this; }
        public void SetTexture(string name, Texture texture) { set[name] = texture; }
        public void SetFloat(string name, float value) { set[name] = value; }
        public void SetVectorArray(string name, Vector4[] values) { set[name] = values; }
    }
    public static class Application { public static string temporaryCachePath; }
    public static class Resources { public static T Load<T>(string name) where T : new() { return new T(); } }
    public static class Graphics {
        public static int drawn;
        public static void DrawMesh(Mesh mesh, Matrix4x4 matrix, Material material, int layer) { drawn++; }
    }
    public static class SubsystemManager {
        public static XR.Hands.XRHandSubsystem hands;
        public static void GetSubsystems(List<XR.Hands.XRHandSubsystem> to) {
            to.Clear();
            if (hands != null) to.Add(hands);
        }
    }
}

namespace UnityEngine.Networking {
    public class UnityWebRequest : IDisposable {
        public enum Result { InProgress, Success }
        public Texture2D texture;
        int _looks;
        public bool isDone { get { return ++_looks > 2; } }
        public Result result { get { return Result.Success; } }
        public string error { get { return ""; } }
        public object SendWebRequest() { return null; }
        public void Dispose() { }
    }
    public static class UnityWebRequestTexture {
        public static UnityWebRequest GetTexture(string uri, bool nonReadable) {
            return new UnityWebRequest { texture = new Texture2D { jpeg = File.ReadAllBytes(new Uri(uri).LocalPath) } };
        }
    }
    public static class DownloadHandlerTexture { public static Texture2D GetContent(UnityWebRequest request) { return request.texture; } }
}

namespace UnityEngine.XR {
    public enum XRNode { LeftEye, RightEye, CenterEye, Head, LeftHand, RightHand }
    [Flags] public enum InputDeviceCharacteristics : uint { EyeTracking = 16 }
    public struct InputFeatureUsage<T> {
        public readonly string name;
        public InputFeatureUsage(string name) { this.name = name; }
    }
    public static class CommonUsages {
        public static InputFeatureUsage<bool> isTracked = new InputFeatureUsage<bool>("IsTracked");
        public static InputFeatureUsage<float> grip = new InputFeatureUsage<float>("Grip"), trigger = new InputFeatureUsage<float>("Trigger");
        public static InputFeatureUsage<Vector3> devicePosition = new InputFeatureUsage<Vector3>("DevicePosition");
        public static InputFeatureUsage<Vector3> leftEyePosition = new InputFeatureUsage<Vector3>("LeftEyePosition");
        public static InputFeatureUsage<Vector3> rightEyePosition = new InputFeatureUsage<Vector3>("RightEyePosition");
        public static InputFeatureUsage<Vector3> centerEyePosition = new InputFeatureUsage<Vector3>("CenterEyePosition");
        public static InputFeatureUsage<Quaternion> deviceRotation = new InputFeatureUsage<Quaternion>("DeviceRotation");
        public static InputFeatureUsage<Quaternion> leftEyeRotation = new InputFeatureUsage<Quaternion>("LeftEyeRotation");
        public static InputFeatureUsage<Quaternion> rightEyeRotation = new InputFeatureUsage<Quaternion>("RightEyeRotation");
        public static InputFeatureUsage<Quaternion> centerEyeRotation = new InputFeatureUsage<Quaternion>("CenterEyeRotation");
    }
    public struct InputDevice {
        public Dictionary<string, object> features;
        public bool TryGetFeatureValue<T>(InputFeatureUsage<T> usage, out T value) {
            object found = null;
            bool has = features != null && features.TryGetValue(usage.name, out found);
            value = has ? (T)found : default(T);
            return has;
        }
    }
    public static class InputDevices {
        public static readonly Dictionary<XRNode, InputDevice> nodes = new Dictionary<XRNode, InputDevice>();
        public static readonly List<InputDevice> eyes = new List<InputDevice>();
        public static InputDevice GetDeviceAtXRNode(XRNode node) { return nodes.ContainsKey(node) ? nodes[node] : new InputDevice(); }
        public static void GetDevicesWithCharacteristics(InputDeviceCharacteristics wanted, List<InputDevice> to) {
            to.Clear();
            to.AddRange(eyes);
        }
    }
}

namespace UnityEngine.XR.Hands {
    public enum XRHandJointID { Invalid, BeginMarker, Wrist = BeginMarker, Palm, EndMarker = 27 }
    public struct XRHandJoint {
        public Pose pose;
        public bool TryGetPose(out Pose found) { found = pose; return true; }
    }
    public struct XRHand {
        public bool isTracked;
        public XRHandJoint GetJoint(XRHandJointID id) {
            return new XRHandJoint { pose = new Pose { position = new Vector3(0.01f * (int)id, 1, 0.5f), rotation = Quaternion.identity } };
        }
    }
    public class XRHandSubsystem {
        public bool running;
        public XRHand leftHand, rightHand;
    }
}
