using System;
using System.Collections.Generic;
using System.IO;
using UnityEngine;
using UnityEngine.Networking;

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

        readonly Queue<double> _shown = new Queue<double>();
        readonly Texture[] _textures = new Texture[4]; // by Names
        readonly UnityWebRequest[] _decoding = new UnityWebRequest[4];
        string _files; // folder
        XrTracking _tracking;
        Placing _placing;
        bool _stereo;
        Reply _loading;
        Material _material;
        Mesh _mesh;

        void OnEnable() {
            if (eyes == null) eyes = Camera.main;
            _files = Application.temporaryCachePath;
            var address = new ServerAddress { Url = url, Token = token, Fingerprint = fingerprint };
            address.Options["avatar"] = avatar;
            address.Options["name"] = userName;
            if (room != "") address.Options["room"] = room;
            if (height > 0) address.Options["height"] = Math.Round(height, 3);
            Link = new Connection(address, true, Write);
            Link.Complained += error => Problem = error.Code + ": " + error.Message;
            _tracking = new XrTracking((position, rotation) => {
                var root = eyes.transform.parent;
                return root ? InSpace(root.TransformPoint(position), root.rotation * rotation) : InSpace(position, rotation);
            });
            _placing = null;
            _material = new Material(Resources.Load<Shader>("GlSplatPicture"));
            _mesh = new Mesh { vertices = new[] { Vector3.zero, Vector3.right, Vector3.up, new Vector3(1, 1, 0) } }; // shares of the picture
            _mesh.triangles = new[] { 0, 1, 2, 2, 1, 3 };
            _mesh.bounds = new Bounds(Vector3.zero, 1000 * Vector3.one); // the shader moves it
        }

        void OnDisable() {
            Link.Dispose();
            _loading = null;
            foreach (var request in _decoding) request?.Dispose();
            for (int i = 0; i < 4; i++) Replace(i, null);
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
            string numbers = $"{Rate:0} fps, {AgeMs:0} ms ({ServerMs:0} at the server) {Problem}";
            if (label != null) label.text = Link.State == LinkState.Open ? numbers : Link.Reason;
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
            if (_stereo && !sample.ContainsKey("head")) return; // the last picture stays
            var cameras = new EyeCamera[_stereo ? 2 : 1];
            var fields = new List<object>();
            for (int i = 0; i < cameras.Length; i++) {
                var pose = _stereo ? _tracking.Eye(i) : InSpace(eyes.transform.position, eyes.transform.rotation);
                if (pose == null) return;
                cameras[i] = Axes.Camera(pose, _stereo ? eyes.GetStereoProjectionMatrix((Camera.StereoscopicEye)i) : eyes.projectionMatrix);
                cameras[i].Depth = room != "" ? CompanyM : _stereo && _placing.View == View.Own ? NearBodyM
                    : cameras[i].Distance(_placing, _stereo ? (double[])sample["head"] : new double[3]); // untracked: at the origin
                fields.Add(cameras[i].Fields(_placing, side, side));
            }
            var request = new Dictionary<string, object> { { "t", Link.Now }, { "eyes", fields }, { "size", new[] { side, side } }, { "crop", true } };
            if (alpha) request["alpha"] = "straight"; // right in gamma and in linear colour space
            if (_placing.View == View.Mirror) request["mirror"] = true;
            if (_stereo && _placing.View == View.Own) request["hide"] = new[] { "head" };
            if (expression != null) sample["expression"] = expression();
            if (sample.Count > 0) request["tracking"] = sample;
            Link.Send(request, cameras);
        }

        string PathOf(Reply reply, int texture) { return Path.Combine(_files, $"glsplat-{reply.FrameId % 8}-{texture}.jpg"); }

        /// <summary>Write the JPEGs to files: only from there does Unity decode off its main thread.</summary>
        void Write(Reply reply) {
            foreach (var eye in reply.Eyes) {
                File.WriteAllBytes(PathOf(reply, 2 * eye.Eye), eye.Colour);
                if (eye.Alpha != null) File.WriteAllBytes(PathOf(reply, 2 * eye.Eye + 1), eye.Alpha);
            }
        }

        /// <summary>Let Unity's worker threads decode the newest reply; show it when all of it is decoded.</summary>
        void Load() {
            if (_loading == null) {
                if ((_loading = Link.Take()) == null) return;
                for (int i = 0; i < 2 * _loading.Eyes.Count; i++) {
                    if (i % 2 == 1 && _loading.Eyes[0].Alpha == null) continue;
                    _decoding[i] = UnityWebRequestTexture.GetTexture(new Uri(PathOf(_loading, i)).AbsoluteUri, true);
                    _decoding[i].SendWebRequest();
                }
            }
            foreach (var request in _decoding) if (request != null && !request.isDone) return;
            for (int i = 0; i < 4; i++) Replace(i, _decoding[i]);
            Show(_loading);
            _loading = null;
        }

        void Replace(int i, UnityWebRequest decoded) {
            if (_textures[i] != null) Destroy(_textures[i]);
            _textures[i] = null;
            _decoding[i] = null;
            if (decoded == null) return;
            if (decoded.result == UnityWebRequest.Result.Success) _textures[i] = DownloadHandlerTexture.GetContent(decoded);
            else Problem = "a picture cannot be decoded: " + decoded.error;
            decoded.Dispose();
        }

        /// <summary>Show the pair where its eyes requested it.</summary>
        void Show(Reply reply) {
            var cameras = (EyeCamera[])reply.About;
            var size = Json.Numbers(Json.Get(reply.Info, "size"));
            var crops = Json.Get(reply.Info, "crop") as List<object>;
            var corners = new Vector4[8];
            for (int i = 0; i < 8; i++) {
                int eye = Math.Min(i / 4, reply.Eyes.Count - 1);
                var box = crops == null ? new[] { 0, 0, size[0], size[1] } : Json.Numbers(crops[eye]);
                double u = (box[0] + i % 2 * box[2]) / size[0], v = (box[1] + (1 - i / 2 % 2) * box[3]) / size[1]; // textures begin at the bottom
                corners[i] = Axes.Point(cameras[eye].Point(u, v));
            }
            _material.SetVectorArray("_Corners", corners);
            for (int i = 0; i < 4; i++) _material.SetTexture(Names[i], _textures[reply.Eyes.Count < 2 ? i % 2 : i]);
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
