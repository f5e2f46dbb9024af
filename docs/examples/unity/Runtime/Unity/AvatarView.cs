using System;
using System.Collections.Generic;
using UnityEngine;

namespace GlSplat {
    /// <summary>Drives an avatar with the headset and shows the server's pictures of it. Put it on an empty object.</summary>
    public sealed class AvatarView : MonoBehaviour {
        const double NearBodyM = 0.5, CompanyM = 1.6; // to the quad: of one's own body; with others in a room
        const double RateMs = 2000; // over which pictures are counted
        static readonly string[] Names = { "_Left", "_LeftAlpha", "_Right", "_RightAlpha" };

        public string url = "ws://127.0.0.1:8000/ws", token = "";
        [Tooltip("SHA-256 of the server's own certificate, as it prints it")] public string fingerprint = "";
        public string avatar = "", room = "", userName = "";
        [Tooltip("Metres; 0: the server measures it")] public float height;
        public View view = View.Mirror;
        [Tooltip("Pixels of an eye's whole field, side x side; only what the avatar covers is sent")] public int side = 1440;
        [Tooltip("Blend with the scene or the passthrough behind")] public bool alpha = true;
        [Tooltip("The camera of the XR Origin; none: the main camera")] public Camera eyes;
        [Tooltip("Shows numbers and problems; may be none")] public TextMesh label;
        public Func<Dictionary<string, object>> expression; // weights by ARKit's names, from a face tracker of yours

        public Connection Link { get; private set; }
        public double AgeMs { get; private set; } // of the newest picture when it was shown, from its request on
        public double ServerMs { get; private set; } // of that, at the server
        public double Rate { get { return _shown.Count * 1000 / RateMs; } } // pictures a second
        public string Problem { get; private set; } // the server's last complaint

        sealed class Asked {
            public EyeCamera[] Cameras;
            public double Depth;
        }

        readonly Queue<double> _shown = new Queue<double>();
        readonly Queue<KeyValuePair<int, byte[]>> _jpegs = new Queue<KeyValuePair<int, byte[]>>(); // of _loading, by texture
        Texture2D[] _front = new Texture2D[4], _back = new Texture2D[4];
        XrTracking _tracking;
        Placing _placing;
        bool _stereo;
        Reply _loading;
        Material _material;
        Mesh _mesh;

        void OnEnable() {
            if (eyes == null) eyes = Camera.main;
            Link = new Connection(new ServerAddress {
                Url = url, Token = token, Fingerprint = fingerprint,
                Options = {
                    { "avatar", avatar }, { "room", room == "" ? null : room }, { "name", userName },
                    { "height", height > 0 ? Math.Round(height, 3) : (object)null }
                }
            });
            Link.Complained += error => Problem = error.Code + ": " + error.Message;
            _tracking = new XrTracking((position, rotation) => {
                var root = eyes.transform.parent;
                return root ? InSpace(root.TransformPoint(position), root.rotation * rotation) : InSpace(position, rotation);
            });
            _placing = null;
            for (int i = 0; i < 8; i++) // alpha is linear
                (i < 4 ? _front : _back)[i % 4] = new Texture2D(2, 2, TextureFormat.RGB24, false, i % 2 == 1) { wrapMode = TextureWrapMode.Clamp };
            _material = new Material(Resources.Load<Shader>("GlSplatPicture"));
            _mesh = new Mesh { vertices = new[] { Vector3.zero, Vector3.right, Vector3.up, new Vector3(1, 1, 0) } }; // shares of the picture
            _mesh.triangles = new[] { 0, 1, 2, 2, 1, 3 };
            _mesh.bounds = new Bounds(Vector3.zero, 1000 * Vector3.one); // the shader moves it
        }

        void OnDisable() {
            Link.Dispose();
            foreach (var texture in _front) Destroy(texture);
            foreach (var texture in _back) Destroy(texture);
            Destroy(_material);
            Destroy(_mesh);
        }

        /// <summary>Put mirror, avatar or room before the user again: after a change of the view or of the headset's origin.</summary>
        public void Recentre() { _placing = null; }

        void Update() {
            var sample = _tracking.Sample();
            bool moved = _placing == null || _stereo != eyes.stereoEnabled;
            if (moved && (!eyes.stereoEnabled || sample.ContainsKey("head"))) Place(); // the sample is of the old space
            else if (!moved) Ask(sample);
            Load();
            while (_shown.Count > 0 && _shown.Peek() < Link.Now - RateMs) _shown.Dequeue();
            if (label == null) return;
            bool open = Link.State == LinkState.Open;
            label.text = open ? $"{Rate:0} fps, {AgeMs:0} ms ({ServerMs:0} at the server) {Problem}" : Link.Reason;
        }

        /// <summary>Lay the space over the tracking space, and choose where the avatar is shown.</summary>
        void Place() {
            _stereo = eyes.stereoEnabled;
            Transform head = eyes.transform, root = head.parent;
            if (room != "") { // docs/protocol.md, 2.1: over the origin, looking along the protocol's +z, to the middle of the room
                var foot = new Vector3(head.position.x, root ? root.position.y : 0, head.position.z);
                transform.SetPositionAndRotation(foot, Quaternion.LookRotation(Vector3.ProjectOnPlane(-head.forward, Vector3.up)));
            } else if (_stereo) transform.SetPositionAndRotation(root ? root.position : Vector3.zero, root ? root.rotation : Quaternion.identity);
            bool own = !_stereo || room != "" && view == View.Facing; // others do not turn with oneself
            _placing = new Placing(own ? View.Own : view, EyeCamera.OfPose(InSpace(head.position, head.rotation)));
        }

        double[] InSpace(Vector3 position, Quaternion rotation) {
            return Axes.Pose(transform.InverseTransformPoint(position), Quaternion.Inverse(transform.rotation) * rotation);
        }

        void Ask(Dictionary<string, object> sample) {
            var asked = new Asked { Cameras = new EyeCamera[_stereo ? 2 : 1], Depth = room != "" ? CompanyM : NearBodyM };
            var fields = new List<object>();
            for (int i = 0; i < asked.Cameras.Length; i++) {
                var pose = _stereo ? _tracking.Eye(i) : InSpace(eyes.transform.position, eyes.transform.rotation);
                if (pose == null || _stereo && !sample.ContainsKey("head")) return; // the last picture stays
                var projection = _stereo ? eyes.GetStereoProjectionMatrix((Camera.StereoscopicEye)i) : eyes.projectionMatrix;
                var camera = asked.Cameras[i] = Axes.Camera(pose, projection);
                if (!_stereo) asked.Depth = camera.Distance(_placing, new double[3]); // the avatar stands at the origin
                else if (room == "" && _placing.View != View.Own) asked.Depth = camera.Distance(_placing, (double[])sample["head"]);
                fields.Add(camera.Fields(_placing, side, side));
            }
            var request = new Dictionary<string, object> { { "t", Link.Now }, { "eyes", fields }, { "size", new[] { side, side } }, { "crop", true } };
            if (alpha) request["alpha"] = "straight"; // right in gamma and in linear colour space
            if (_placing.View == View.Mirror) request["mirror"] = true;
            if (_stereo && _placing.View == View.Own) request["hide"] = new[] { "head" };
            if (expression != null) sample["expression"] = expression();
            if (sample.Count > 0) request["tracking"] = sample;
            Link.Send(request, asked);
        }

        /// <summary>Decode one JPEG of the newest reply. Unity decodes on this thread only, so no frame decodes more.</summary>
        void Load() {
            if (_loading == null) {
                if ((_loading = Link.Take()) == null) return;
                foreach (var eye in _loading.Eyes) {
                    _jpegs.Enqueue(new KeyValuePair<int, byte[]>(2 * eye.Eye, eye.Colour));
                    if (eye.Alpha != null) _jpegs.Enqueue(new KeyValuePair<int, byte[]>(2 * eye.Eye + 1, eye.Alpha));
                }
            }
            var next = _jpegs.Dequeue();
            _back[next.Key].LoadImage(next.Value);
            if (_jpegs.Count > 0) return;
            Show(_loading);
            _loading = null;
        }

        /// <summary>Show the decoded pair where its eyes saw it.</summary>
        void Show(Reply reply) {
            var swapped = _front;
            _front = _back;
            _back = swapped;
            var asked = (Asked)reply.About;
            var size = Json.Numbers(Json.Get(reply.Info, "size"));
            var crops = Json.Get(reply.Info, "crop") as List<object>;
            var corners = new Vector4[8];
            for (int i = 0; i < 8; i++) {
                int eye = Math.Min(i / 4, reply.Eyes.Count - 1);
                var box = crops == null ? new[] { 0, 0, size[0], size[1] } : Json.Numbers(crops[eye]);
                double u = (box[0] + i % 2 * box[2]) / size[0], v = (box[1] + (1 - i / 2 % 2) * box[3]) / size[1]; // textures begin at the bottom
                corners[i] = Axes.Point(asked.Cameras[eye].Point(u, v, asked.Depth));
            }
            _material.SetVectorArray("_Corners", corners);
            for (int i = 0; i < 4; i++) _material.SetTexture(Names[i], _front[reply.Eyes.Count < 2 ? i % 2 : i]);
            _material.SetFloat("_Opaque", reply.Eyes[0].Alpha == null ? 1 : 0);
            AgeMs = Link.Now - reply.RequestedAt;
            ServerMs = Json.Get(Json.Get(reply.Info, "times"), "total") as double? ?? 0;
            _shown.Enqueue(Link.Now);
        }

        void LateUpdate() {
            if (_shown.Count > 0) Graphics.DrawMesh(_mesh, transform.localToWorldMatrix, _material, gameObject.layer);
        }
    }
}
