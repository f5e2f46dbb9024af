// The C# client for its tests: answers vectors, or streams what it reads, a JSON object a line, and prints one for each.
using System;
using System.Collections.Generic;
using System.Linq;
using System.Threading;
using GlSplat;
using Map = System.Collections.Generic.Dictionary<string, object>;

static class Runner {
    const int HangMs = 120000;

    static int Main(string[] words) {
        if (words[0] == "vectors")
            foreach (var input in (List<object>)Json.Parse(Console.In.ReadToEnd())) Print(Answer(words[1], (Map)input));
        else Stream((Map)Json.Parse(Console.ReadLine()));
        return 0;
    }

    static void Print(object value) {
        Console.WriteLine(Json.Write(value));
        Console.Out.Flush();
    }

    static object Answer(string name, Map given) {
        try {
            if (name == "address") return Query(Address(given).ToUri((string)Json.Get(given, "resume")));
            if (name == "reply") return Parts(Reply.Parse(Convert.FromBase64String((string)given["data"])));
            if (name == "eye") return EyeFields(given);
            if (name == "views") return Views(Matrix(given["head"]), Matrix(given["eye"]));
            return Conversation((List<object>)given["steps"]);
        } catch (FormatException) {
            return null; // refused
        }
    }

    static ServerAddress Address(Map given) {
        var address = new ServerAddress { Url = (string)given["url"], Token = (string)Json.Get(given, "token") ?? "" };
        address.Fingerprint = (string)Json.Get(given, "fingerprint") ?? "";
        foreach (var option in (Map)given["options"]) address.Options[option.Key] = option.Value;
        return address;
    }

    static Map Query(Uri uri) {
        var parts = uri.Query.TrimStart('?').Split('&').Where(p => p != "").Select(p => p.Split('='));
        var query = parts.ToDictionary(p => p[0], p => (object)Uri.UnescapeDataString(p[1]));
        return new Map { { "path", uri.AbsolutePath }, { "query", query } };
    }

    static Map Parts(Reply reply) {
        var eyes = reply.Eyes.Select(e => new object[] { e.Eye, Convert.ToBase64String(e.Colour), Convert.ToBase64String(e.Alpha ?? new byte[0]) });
        return new Map { { "id", reply.FrameId }, { "eyes", eyes }, { "info", reply.Info } };
    }

    static object EyeFields(Map given) {
        var p = Json.Numbers(given["projection"]).Select(v => (float)v).ToArray(); // by columns
        var size = Json.Numbers(given["size"]);
        var eye = new EyeCamera(Json.Numbers(given["pose"]), (p[8] - 1) / p[0], (p[8] + 1) / p[0], (p[9] - 1) / p[5], (p[9] + 1) / p[5]);
        return eye.Fields(new Placing(View.Own, System.Numerics.Matrix4x4.Identity), size[0], size[1]);
    }

    // Matrices by columns are those of row vectors by rows.
    static System.Numerics.Matrix4x4 Matrix(object value) {
        var m = Json.Numbers(value).Select(v => (float)v).ToArray();
        return new System.Numerics.Matrix4x4(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9], m[10], m[11], m[12], m[13], m[14], m[15]);
    }

    static double[] Columns(System.Numerics.Matrix4x4 m) {
        return new double[] { m.M11, m.M12, m.M13, m.M14, m.M21, m.M22, m.M23, m.M24, m.M31, m.M32, m.M33, m.M34, m.M41, m.M42, m.M43, m.M44 };
    }

    static object Views(System.Numerics.Matrix4x4 head, System.Numerics.Matrix4x4 eye) {
        return new[] { View.Mirror, View.Facing, View.Own }.Select(view => {
            var placing = new Placing(view, head);
            return (object)new Map { { "shown", Columns(placing.Shown) }, { "server", Columns(placing.ServerEye(eye)) } };
        }).ToList();
    }

    static object Conversation(List<object> steps) {
        var session = new Session(true);
        var found = new List<object>();
        foreach (Map step in steps) {
            double now = (double)step["at"];
            string does = (string)step["do"], sent;
            if (does == "open") session.Opened();
            if (does == "request") found.Add(Json.Parse(session.Request(new Map(), null, now)));
            else if (does == "binary") {
                Reply reply = null;
                object shown = false; // unreadable
                sent = null;
                try {
                    reply = session.Arrived(Convert.FromBase64String((string)step["data"]), now, out sent);
                    shown = reply == null ? null : (object)reply.FrameId;
                } catch (FormatException) { }
                found.Add(new Map { { "shown", shown }, { "sent", sent == null ? null : Json.Parse(sent) } });
            } else if (does == "text") {
                var error = session.Refused((string)step["data"]);
                found.Add(new Map { { "code", error.Code }, { "message", error.Message }, { "frame_id", error.FrameId } });
            } else found.Add(null);
        }
        return found;
    }

    static void Stream(Map given) {
        var complaints = new Queue<ServerError>();
        using (var link = new Connection(Address(given), false)) {
            link.Complained += error => { lock (complaints) complaints.Enqueue(error); };
            string line;
            while ((line = Console.ReadLine()) != null) {
                var request = (Map)Json.Parse(line);
                string wanted = (string)Json.Get(request, "state");
                object answer = null;
                bool sent = false;
                for (int waited = 0; answer == null && waited < HangMs; waited += 2, Thread.Sleep(2)) {
                    if (wanted != null) {
                        if (link.State.ToString() == wanted) answer = State(link);
                        continue;
                    }
                    if (!sent) sent = link.Send(request, waited);
                    else if (request.ContainsKey("lost") && link.State == LinkState.Waiting) answer = State(link);
                    var reply = link.Take();
                    if (reply != null) answer = Parts(reply);
                    lock (complaints)
                        if (complaints.Count > 0) answer = new Map { { "code", complaints.Peek().Code }, { "frame_id", complaints.Dequeue().FrameId } };
                }
                Print(answer ?? State(link));
            }
        }
    }

    static Map State(Connection link) { return new Map { { "state", link.State.ToString() }, { "reason", link.Reason } }; }
}
