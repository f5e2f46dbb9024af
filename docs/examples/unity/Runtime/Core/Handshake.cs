using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Net.Security;
using System.Net.Sockets;
using System.Net.WebSockets;
using System.Security.Cryptography;
using System.Text;
using System.Threading;
using System.Threading.Tasks;

namespace GlSplat {
    /// <summary>Where a server is, and what to send in the handshake.</summary>
    public sealed class ServerAddress {
        public string Url = "ws://127.0.0.1:8000/ws";
        public string Token = ""; // empty: none
        public string Fingerprint = ""; // SHA-256 of the one certificate to trust, as `serve` prints it; empty: the system's
        /// <summary>Options of docs/protocol.md, section 2: avatar, room, name, height, ...; empty ones are left out.</summary>
        public readonly Dictionary<string, object> Options = new Dictionary<string, object>();

        /// <summary>Return the address to open, in a room as the person of the token <paramref name="resume"/>.</summary>
        public Uri ToUri(string resume = null) {
            var uri = new UriBuilder(Url);
            if (uri.Path == "/") uri.Path = "/ws";
            var options = new Dictionary<string, object>(Options);
            if (options.ContainsKey("room")) options["resume"] = resume;
            var texts = options.ToDictionary(o => o.Key, o => o.Value as string ?? (o.Value == null ? "" : Json.Write(o.Value)));
            uri.Query = string.Join("&", texts.Where(o => o.Value != "").Select(o => o.Key + "=" + Uri.EscapeDataString(o.Value)));
            return uri.Uri;
        }
    }

    /// <summary>The server's answer to a handshake that it refuses.</summary>
    public sealed class RefusedException : Exception {
        public readonly int Status; // of HTTP
        public readonly double RetryAfter; // seconds

        public RefusedException(int status, double retryAfter, string words) : base("the server refuses (" + status + "): " + words) {
            Status = status;
            RetryAfter = retryAfter;
        }
    }

    /// <summary>
    /// Opens a WebSocket. ClientWebSocket reports no reason of a refusal, trusts no certificate by its fingerprint on all
    /// platforms, and leaves Nagle's algorithm on, by which a request waits until the packet before it is acknowledged.
    /// </summary>
    static class Handshake {
        const double TimeoutS = 10;
        const int MaxHead = 8192, MaxWords = 500; // bytes

        /// <summary>Throws RefusedException and what sockets throw.</summary>
        public static async Task<WebSocket> Open(ServerAddress address, string resume, CancellationToken stop) {
            var uri = address.ToUri(resume);
            var tcp = new TcpClient { NoDelay = true };
            using (var late = CancellationTokenSource.CreateLinkedTokenSource(stop))
            using (late.Token.Register(tcp.Close)) { // streams of sockets do not heed tokens
                late.CancelAfter(TimeSpan.FromSeconds(TimeoutS));
                try {
                    await tcp.ConnectAsync(uri.DnsSafeHost, uri.Port);
                    Stream stream = tcp.GetStream();
                    if (uri.Scheme == "wss") {
                        var tls = new SslStream(stream, false, (_, certificate, chain, errors) =>
                            address.Fingerprint == "" ? errors == SslPolicyErrors.None : IsOf(certificate.GetRawCertData(), address.Fingerprint));
                        await tls.AuthenticateAsClientAsync(uri.DnsSafeHost);
                        stream = tls;
                    }
                    await Upgrade(stream, uri, address.Token);
                    return WebSocket.CreateFromStream(stream, false, null, TimeSpan.Zero);
                } catch (Exception) {
                    tcp.Close();
                    if (late.IsCancellationRequested) throw new TimeoutException("no answer within " + TimeoutS + " s");
                    throw;
                }
            }
        }

        static bool IsOf(byte[] certificate, string fingerprint) {
            using (var sha = SHA256.Create())
                return BitConverter.ToString(sha.ComputeHash(certificate)) == fingerprint.Trim().Replace(':', '-').ToUpperInvariant();
        }

        static async Task Upgrade(Stream stream, Uri uri, string token) {
            string key = Convert.ToBase64String(Guid.NewGuid().ToByteArray()); // a nonce, no secret
            var request = Encoding.ASCII.GetBytes("GET " + uri.PathAndQuery + " HTTP/1.1\r\nHost: " + uri.Authority
                + (token == "" ? "" : "\r\nAuthorization: Bearer " + token) + "\r\nUpgrade: websocket\r\nConnection: Upgrade"
                + "\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: " + key + "\r\n\r\n");
            await stream.WriteAsync(request, 0, request.Length);
            string head = "";
            for (var one = new byte[1]; !head.EndsWith("\r\n\r\n") && head.Length < MaxHead; head += (char)one[0])
                if (await stream.ReadAsync(one, 0, 1) == 0) throw new IOException("closed at once: does it want wss://?");
            if (!head.StartsWith("HTTP/1.1 ") || !int.TryParse(head.Substring(9, 3), out int status))
                throw new IOException("what listens there does not speak HTTP");
            if (status == 101) return;
            var words = new byte[Math.Min(Header(head, "Content-Length"), MaxWords)];
            for (int read = 0, some = 1; read < words.Length && some > 0; read += some)
                some = await stream.ReadAsync(words, read, words.Length - read);
            throw new RefusedException(status, Header(head, "Retry-After"), Encoding.UTF8.GetString(words).Trim('\0', '\n'));
        }

        /// <summary>Return a header's whole number; 0 where it has none.</summary>
        static int Header(string head, string name) {
            var line = head.Split('\n').FirstOrDefault(l => l.StartsWith(name + ":", StringComparison.OrdinalIgnoreCase));
            return line != null && int.TryParse(line.Substring(name.Length + 1), out int value) ? value : 0;
        }
    }
}
