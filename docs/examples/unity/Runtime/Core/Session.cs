using System;
using System.Collections.Generic;
using System.Linq;

namespace GlSplat {
    /// <summary>An error that the server reports in a text message (docs/protocol.md, section 6).</summary>
    public sealed class ServerError {
        public string Code, Message;
        public uint? FrameId; // of the request that it answers
    }

    /// <summary>
    /// The client's half of one connection after another, without I/O: counts requests, matches replies, acknowledges.
    /// Times are milliseconds of the client's clock.
    /// </summary>
    public sealed class Session {
        const int MaxRemembered = 256; // requests
        const double MaxArrivalMs = 60000; // longest time that may be reported

        public uint Newest { get; private set; } // frame_id of the newest request of this connection
        public uint Received { get; private set; } // of its newest picture
        public int Late { get; private set; } // replies that were dropped, as a newer one had come
        public string Resume { get; private set; } // token with which a connection is the same person in a room
        readonly SortedDictionary<uint, KeyValuePair<double, object>> _asked = new SortedDictionary<uint, KeyValuePair<double, object>>();
        readonly bool _reportArrivals;
        double _age, _arrivedAt = -1; // of the newest picture, until reported

        public Session(bool reportArrivals) { _reportArrivals = reportArrivals; }

        /// <summary>Begin a new connection: frame_ids begin at 1.</summary>
        public void Opened() {
            Newest = Received = 0;
            _arrivedAt = -1;
            _asked.Clear();
        }

        /// <summary>Return the message that requests a picture; <paramref name="about"/> comes back with the reply.</summary>
        /// <param name="fields">Fields of docs/protocol.md, section 3, without v, frame_id and ack.</param>
        public string Request(IDictionary<string, object> fields, object about, double now) {
            _asked[++Newest] = new KeyValuePair<double, object>(now, about);
            if (_asked.Count > MaxRemembered) Forget(_asked.Keys.First());
            var message = Acknowledging(now);
            message["frame_id"] = Newest;
            foreach (var field in fields) message[field.Key] = field.Value;
            return Json.Write(message);
        }

        /// <summary>Parse a reply; return null for one that is late or was never requested. Throws FormatException.</summary>
        /// <param name="acknowledgement">A message to send at once, as newer requests may wait for it; or null.</param>
        public Reply Arrived(byte[] data, double now, out string acknowledgement) {
            acknowledgement = null;
            var reply = Reply.Parse(data);
            if (!_asked.TryGetValue(reply.FrameId, out var asked)) {
                Late++;
                return null;
            }
            Forget(reply.FrameId); // once a reply has come, none to an earlier request will
            reply.RequestedAt = asked.Key;
            reply.About = asked.Value;
            reply.ArrivedAt = _arrivedAt = now;
            _age = now - asked.Key;
            Received = reply.FrameId;
            Resume = Json.Get(Json.Get(reply.Info, "room"), "resume") as string ?? Resume;
            if (_asked.Count > 0) acknowledgement = Json.Write(Acknowledging(now));
            return reply;
        }

        /// <summary>Parse a text message, which is an error. Throws FormatException.</summary>
        public ServerError Refused(string text) {
            var error = Json.Get(Json.Parse(text), "error");
            var number = (uint?)(Json.Get(error, "frame_id") as double?);
            var code = Json.Get(error, "code") as string;
            if (code == null) throw new FormatException("expected an error in a text message");
            if (number != null) _asked.Remove(number.Value);
            return new ServerError { Code = code, Message = Json.Get(error, "message") as string, FrameId = number };
        }

        Dictionary<string, object> Acknowledging(double now) {
            var fields = new Dictionary<string, object> { { "v", 1 }, { "ack", Received } };
            if (_reportArrivals && _arrivedAt >= 0) {
                double age = Math.Min(_age, MaxArrivalMs), held = Math.Min(now - _arrivedAt, MaxArrivalMs);
                fields["arrival"] = new Dictionary<string, object> { { "age", age }, { "held", held } };
                _arrivedAt = -1;
            }
            return fields;
        }

        void Forget(uint upTo) {
            foreach (var number in _asked.Keys.TakeWhile(n => n <= upTo).ToList()) _asked.Remove(number);
        }
    }
}
