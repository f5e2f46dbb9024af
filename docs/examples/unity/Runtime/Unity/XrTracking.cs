using System;
using System.Collections.Generic;
using UnityEngine;
using UnityEngine.XR;
#if GLSPLAT_HANDS // com.unity.xr.hands is installed: versionDefines of the assembly
using UnityEngine.XR.Hands;
#endif

namespace GlSplat {
    /// <summary>Reads the headset into `tracking` of docs/protocol.md, section 3.3.</summary>
    sealed class XrTracking {
        const float Grasp = 0.25f; // curl of fingers around a controller that presses nothing
        static readonly InputFeatureUsage<Quaternion> Gaze = new InputFeatureUsage<Quaternion>("gazeRotation"); // of the OpenXR plug-in
        readonly List<InputDevice> _devices = new List<InputDevice>();
        readonly Func<Vector3, Quaternion, double[]> _pose;

        /// <param name="pose">Converts a pose of the tracking space to the protocol's.</param>
        public XrTracking(Func<Vector3, Quaternion, double[]> pose) { _pose = pose; }

        /// <summary>Return a sample: what is not tracked is not in it.</summary>
        public Dictionary<string, object> Sample() {
            var sample = new Dictionary<string, object>();
            var head = InputDevices.GetDeviceAtXRNode(XRNode.Head);
            Add(sample, "head", head, CommonUsages.centerEyePosition, CommonUsages.centerEyeRotation);
            AddController(sample, "left", XRNode.LeftHand);
            AddController(sample, "right", XRNode.RightHand);
            AddHands(sample);
            InputDevices.GetDevicesWithCharacteristics(InputDeviceCharacteristics.EyeTracking, _devices);
            foreach (var eyes in _devices)
                if (eyes.TryGetFeatureValue(Gaze, out var gaze) && head.TryGetFeatureValue(CommonUsages.centerEyeRotation, out var look))
                    sample["leftEye"] = sample["rightEye"] = Axes.Direction(Quaternion.Inverse(look) * gaze * Vector3.forward);
            return sample;
        }

        /// <summary>Return the pose of eye 0 (left) or 1; null if untracked.</summary>
        public double[] Eye(int eye) {
            var found = new Dictionary<string, object>();
            Add(found, "eye", InputDevices.GetDeviceAtXRNode(XRNode.Head), eye == 0 ? CommonUsages.leftEyePosition : CommonUsages.rightEyePosition,
                eye == 0 ? CommonUsages.leftEyeRotation : CommonUsages.rightEyeRotation);
            return found.Count > 0 ? (double[])found["eye"] : null;
        }

        void Add(Dictionary<string, object> to, string key, InputDevice device, InputFeatureUsage<Vector3> where, InputFeatureUsage<Quaternion> how) {
            if (device.TryGetFeatureValue(CommonUsages.isTracked, out var tracked) && !tracked) return;
            if (device.TryGetFeatureValue(where, out var position) && device.TryGetFeatureValue(how, out var rotation)) to[key] = _pose(position, rotation);
        }

        void AddController(Dictionary<string, object> sample, string side, XRNode node) {
            var device = InputDevices.GetDeviceAtXRNode(node);
            Add(sample, side + "_grip", device, CommonUsages.devicePosition, CommonUsages.deviceRotation);
            if (!sample.ContainsKey(side + "_grip") || !device.TryGetFeatureValue(CommonUsages.grip, out var grip)) return;
            device.TryGetFeatureValue(CommonUsages.trigger, out var trigger);
            sample[side + "_curl"] = Grasp + (1 - Grasp) * Math.Max(grip, trigger / 2); // one finger is not a fist
        }

        void AddHands(Dictionary<string, object> sample) {
#if GLSPLAT_HANDS
            SubsystemManager.GetSubsystems(_subsystems);
            foreach (var hands in _subsystems) {
                if (hands.running && hands.leftHand.isTracked) AddHand(sample, "left", hands.leftHand);
                if (hands.running && hands.rightHand.isTracked) AddHand(sample, "right", hands.rightHand);
            }
        }

        readonly List<XRHandSubsystem> _subsystems = new List<XRHandSubsystem>();

        void AddHand(Dictionary<string, object> sample, string side, XRHand hand) {
            var joints = new List<double>();
            for (var id = XRHandJointID.BeginMarker; id < XRHandJointID.EndMarker; id++) { // WebXR's order, and the palm
                if (id == XRHandJointID.Palm) continue;
                if (!hand.GetJoint(id).TryGetPose(out var pose)) return;
                var found = _pose(pose.position, pose.rotation);
                if (id == XRHandJointID.Wrist) sample[side] = found;
                joints.AddRange(new[] { found[0], found[1], found[2] });
            }
            sample[side + "_joints"] = joints;
#endif
        }
    }
}
