using System;
using System.Collections.Generic;
using System.Text;

namespace GlSplat {
    /// <summary>One eye of a reply.</summary>
    public struct EyePicture {
        public int Eye; // 0 left, 1 right
        public byte[] Colour, Alpha; // JPEGs; Alpha, a grey one, is null unless requested
    }

    /// <summary>A parsed reply (docs/protocol.md, section 4).</summary>
    public sealed class Reply {
        const int Jpeg = 0xd8ff; // first bytes: FF D8
        public uint FrameId;
        public readonly List<EyePicture> Eyes = new List<EyePicture>();
        public Dictionary<string, object> Info;
        public object About; // what its request was about
        public double RequestedAt, ArrivedAt; // milliseconds of the client's clock
        int _at = 9;

        /// <summary>Parse a binary message. Throws FormatException.</summary>
        public static Reply Parse(byte[] data) {
            if (data.Length < 9 || data[0] != 'V' || data[1] != 'R') throw new FormatException("expected a reply, VR");
            if (U16(data, 2) != 1) throw new FormatException("expected a reply of version 1, got " + U16(data, 2));
            var reply = new Reply { FrameId = U32(data, 4) };
            for (int count = data[8]; count > 0; count--) {
                var eye = new EyePicture { Eye = reply._at < data.Length ? data[reply._at++] : 0, Colour = reply.Part(data) };
                // these bytes begin neither another picture's length nor a JSON object
                if (reply._at + 6 <= data.Length && U16(data, reply._at + 4) == Jpeg) eye.Alpha = reply.Part(data);
                reply.Eyes.Add(eye);
            }
            reply.Info = Json.Parse(Encoding.UTF8.GetString(reply.Part(data))) as Dictionary<string, object>;
            if (reply.Info == null) throw new FormatException("expected a JSON object in a reply");
            return reply;
        }

        byte[] Part(byte[] data) {
            uint length = _at + 4 > data.Length ? uint.MaxValue : U32(data, _at);
            if (length > data.Length - _at - 4) throw new FormatException("a reply ends early");
            var part = new byte[length];
            Buffer.BlockCopy(data, _at + 4, part, 0, part.Length);
            _at += 4 + part.Length;
            return part;
        }

        static int U16(byte[] data, int at) { return data[at] | data[at + 1] << 8; }

        static uint U32(byte[] data, int at) { return (uint)(U16(data, at) | U16(data, at + 2) << 16); }
    }
}
