// A scene of stubs: an XR rig somewhere in the world, a headset, a controller, a hand, and an AvatarView for a while.
using System;
using System.Collections.Generic;
using System.Linq;
using System.Reflection;
using System.Threading;
using GlSplat;
using UnityEngine;
using UnityEngine.XR;
using UnityEngine.XR.Hands;

static class Scene {
    const int HangMs = 60000;
    static readonly Vector3 Head = new Vector3(0.2f, 1.6f, 0.1f); // in the tracking space
    static readonly Quaternion Look = new Quaternion(0.1f, 0.5f, 0, 0.860233f); // to the right, and a little down

    static void Main(string[] words) {
        Application.temporaryCachePath = words[2];
        var root = new Transform { position = new Vector3(3, 1, -2), rotation = new Quaternion(0, 0.6f, 0, 0.8f) };
        var camera = new Camera { stereoEnabled = words[1] != "Desktop" };
        camera.transform.parent = root;
        camera.transform.position = root.TransformPoint(Head);
        camera.transform.rotation = root.rotation * Look;
        for (int eye = 0; eye < 2; eye++) // off-centre, mirrored
            camera.stereo[eye] = new Matrix4x4 { m00 = 0.9f, m11 = 0.95f, m02 = eye == 0 ? -0.2f : 0.2f, m12 = 0.1f };
        camera.projectionMatrix = new Matrix4x4 { m00 = 1.2f, m11 = 1.6f };
        if (camera.stereoEnabled) Track();
        var scene = new AvatarView { url = words[0], eyes = camera, side = 64, label = new TextMesh() };
        if (words[1] == "Room") scene.room = "lab";
        else if (words[1] == "Desktop") scene.transform.SetPositionAndRotation(root.TransformPoint(new Vector3(1, 0, 2)), Quaternion.identity);
        else scene.view = (View)Enum.Parse(typeof(View), words[1]);
        Call(scene, "OnEnable");
        for (int waited = 0; UnityEngine.Graphics.drawn == 0 && waited < HangMs; waited += 5, Thread.Sleep(5)) {
            Call(scene, "Update");
            Call(scene, "LateUpdate");
        }
        var found = Material.last.set;
        var corners = ((Vector4[])found["_Corners"]).Select(c => (object)new double[] { c.x, c.y, c.z }).ToList();
        var pictures = new[] { "_Left", "_LeftAlpha", "_Right", "_RightAlpha" }.Select(n => Convert.ToBase64String(((Texture2D)found[n]).jpeg));
        var place = scene.transform.position;
        Console.WriteLine(Json.Write(new Dictionary<string, object> {
            { "corners", corners }, { "pictures", pictures.ToList() }, { "opaque", found["_Opaque"] }, { "label", scene.label.text },
            { "place", new double[] { place.x, place.y, place.z } }
        }));
        Call(scene, "OnDisable");
    }

    static void Call(AvatarView scene, string method) {
        typeof(AvatarView).GetMethod(method, BindingFlags.Instance | BindingFlags.NonPublic).Invoke(scene, null);
    }

    static void Track() {
        var headset = new Dictionary<string, object> { { "IsTracked", true } };
        foreach (var name in new[] { "CenterEye", "LeftEye", "RightEye" }) {
            float half = name == "LeftEye" ? -0.03f : name == "RightEye" ? 0.03f : 0;
            headset[name + "Position"] = Head + Look * new Vector3(half, 0, 0);
            headset[name + "Rotation"] = Look;
        }
        InputDevices.nodes[XRNode.Head] = new InputDevice { features = headset };
        var controller = new Dictionary<string, object> {
            { "DevicePosition", new Vector3(-0.3f, 1, 0.4f) }, { "DeviceRotation", Quaternion.identity }, { "Grip", 0.5f }, { "Trigger", 0f }
        };
        InputDevices.nodes[XRNode.LeftHand] = new InputDevice { features = controller };
        InputDevices.nodes[XRNode.RightHand] = new InputDevice { features = new Dictionary<string, object> { { "IsTracked", false } } };
        InputDevices.eyes.Add(new InputDevice { features = new Dictionary<string, object> { { "gazeRotation", Look } } });
        SubsystemManager.hands = new XRHandSubsystem { running = true, rightHand = new XRHand { isTracked = true } };
    }
}
