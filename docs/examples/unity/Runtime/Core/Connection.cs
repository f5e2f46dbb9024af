using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.IO;
using System.Net.WebSockets;
using System.Text;
using System.Threading;
using System.Threading.Tasks;

namespace GlSplat {
    public enum LinkState { Off, Connecting, Open, Waiting }

    /// <summary>
    /// Streams from a server on threads of its own, reconnects, and keeps the newest reply. Its methods never wait, and any
    /// thread may call them.
    /// </summary>
    public sealed class Connection : IDisposable {
        const int MaxReplyBytes = 64 << 20;
        const double StalledSendMs = 5000; // until a link counts as broken
        static readonly double[] PausesS = { 0.5, 1, 2, 4, 8 }; // between attempts

        public LinkState State { get; private set; }
        public string Reason { get; private set; } // why it is not open, in words
        public event Action<ServerError> Complained; // raised on a thread of the connection

        readonly ServerAddress _address;
        readonly Action<Reply> _prepare;
        readonly Session _session;
        readonly Stopwatch _clock = Stopwatch.StartNew();
        readonly CancellationTokenSource _stop = new CancellationTokenSource();
        readonly object _lock = new object();
        WebSocket _socket;
        Reply _ready;
        bool _sending;
        double _sentAt;

        /// <param name="reportArrivals">Let the server fit pictures to the link (docs/protocol.md, section 5.1).</param>
        /// <param name="prepare">Called with each reply on the receiving thread, before it can be taken.</param>
        public Connection(ServerAddress address, bool reportArrivals = true, Action<Reply> prepare = null) {
            _address = address;
            _prepare = prepare;
            _session = new Session(reportArrivals);
            Become(LinkState.Connecting, "");
            Task.Run(Run);
        }

        /// <summary>Milliseconds of the clock of all times.</summary>
        public double Now { get { return _clock.Elapsed.TotalMilliseconds; } }

        /// <summary>Send a request; return false if the link is not open, or still busy with the one before.</summary>
        public bool Send(IDictionary<string, object> fields, object about) {
            lock (_lock) {
                if (State != LinkState.Open) return false;
                if (_sending && Now - _sentAt > StalledSendMs) _socket.Abort();
                if (_sending) return false;
                Begin(_session.Request(fields, about, Now));
                return true;
            }
        }

        /// <summary>Return the newest reply, once, or null.</summary>
        public Reply Take() { return Interlocked.Exchange(ref _ready, null); }

        /// <summary>Close the connection for good.</summary>
        public void Dispose() {
            _stop.Cancel();
            lock (_lock) if (_socket != null) _socket.Abort();
        }

        async Task Run() {
            for (int failures = 0; !_stop.IsCancellationRequested; failures++) {
                double pause = 0;
                string reason;
                try {
                    Become(LinkState.Connecting, Reason);
                    using (var socket = await Handshake.Open(_address, _session.Resume, _stop.Token)) {
                        lock (_lock) {
                            _socket = socket;
                            _sending = false;
                            _session.Opened();
                        }
                        Become(LinkState.Open, "");
                        reason = await Receive(socket);
                    }
                } catch (RefusedException error) {
                    reason = error.Message;
                    pause = error.RetryAfter;
                    if (error.Status == 401) { // the server blocks an address that repeats a wrong token
                        Become(LinkState.Off, reason);
                        return;
                    }
                } catch (Exception error) {
                    reason = "no connection (" + error.GetBaseException().Message + ")";
                }
                if (State == LinkState.Open && _session.Received > 0) failures = 0; // a server may accept and drop at once
                Become(LinkState.Waiting, reason + "; trying again");
                pause = Math.Max(pause, PausesS[Math.Min(failures, PausesS.Length - 1)]);
                await Task.WhenAny(Task.Delay(TimeSpan.FromSeconds(pause), _stop.Token));
            }
            Become(LinkState.Off, "");
        }

        void Become(LinkState state, string reason) {
            lock (_lock) {
                State = state;
                Reason = reason;
            }
        }

        /// <summary>Read messages until the server closes the connection; return why it did. Throws what sockets throw.</summary>
        async Task<string> Receive(WebSocket socket) {
            var buffer = new byte[1 << 18];
            for (int length = 0; ; ) {
                var part = await socket.ReceiveAsync(new ArraySegment<byte>(buffer, length, buffer.Length - length), _stop.Token);
                if (part.MessageType == WebSocketMessageType.Close)
                    return "the server closed the connection (" + (int?)part.CloseStatus + " " + part.CloseStatusDescription + ")";
                length += part.Count;
                if (!part.EndOfMessage) {
                    if (length >= MaxReplyBytes) throw new IOException("a reply is too long");
                    if (length == buffer.Length) Array.Resize(ref buffer, 2 * length);
                    continue;
                }
                var data = new byte[length];
                Buffer.BlockCopy(buffer, 0, data, 0, length);
                length = 0;
                try {
                    if (part.MessageType == WebSocketMessageType.Binary) Arrived(data);
                    else lock (_lock) Complained?.Invoke(_session.Refused(Encoding.UTF8.GetString(data)));
                } catch (FormatException error) {
                    Complained?.Invoke(new ServerError { Code = "bad_reply", Message = error.Message });
                }
            }
        }

        void Arrived(byte[] data) {
            Reply reply;
            lock (_lock) {
                reply = _session.Arrived(data, Now, out var acknowledgement);
                if (acknowledgement != null && !_sending) Begin(acknowledgement); // else the next request acknowledges
            }
            if (reply == null) return;
            _prepare?.Invoke(reply);
            _ready = reply; // the one before is not missed
        }

        /// <summary>Send a message, one at a time.</summary>
        void Begin(string text) {
            var data = new ArraySegment<byte>(Encoding.UTF8.GetBytes(text));
            var socket = _socket;
            _sending = true;
            _sentAt = Now;
            Task.Run(async () => {
                try {
                    await socket.SendAsync(data, WebSocketMessageType.Text, true, _stop.Token);
                } catch (Exception) {
                    socket.Abort(); // Receive ends, and says why
                }
                lock (_lock) if (socket == _socket) _sending = false;
            });
        }
    }
}
