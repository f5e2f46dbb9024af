using System;
using System.Collections;
using System.Collections.Generic;
using System.Globalization;
using System.Text;
using System.Text.RegularExpressions;

namespace GlSplat {
    /// <summary>Reads and writes JSON: Dictionary&lt;string, object&gt;, List&lt;object&gt;, string, double, bool, null.</summary>
    public sealed class Json {
        const int MaxDepth = 64;
        static readonly CultureInfo Plain = CultureInfo.InvariantCulture;
        static readonly Regex Token = new Regex( // a string, a number, a word, a sign
            @"\G\s*(?:""([^""\\]*(?:\\.[^""\\]*)*)""|(-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)|(true|false|null)|([{}\[\],:]))");
        static readonly Regex Escape = new Regex(@"\\(?:u([0-9a-fA-F]{4})|(.))"), Special = new Regex("[\\x00-\\x1f\"\\\\]");
        readonly string _text;
        int _at;

        Json(string text) { _text = text; }

        /// <summary>Parse one value. Throws FormatException.</summary>
        public static object Parse(string text) {
            var json = new Json(text);
            var value = json.Value(0);
            if (text.Substring(json._at).Trim() != "") throw json.Unexpected();
            return value;
        }

        /// <summary>Return an object's value; null where it has none, or is no object.</summary>
        public static object Get(object value, string key) {
            object found = null;
            (value as Dictionary<string, object>)?.TryGetValue(key, out found);
            return found;
        }

        /// <summary>Return a list's numbers; null where it is no list of numbers.</summary>
        public static double[] Numbers(object value) {
            var list = value as List<object>;
            return list != null && list.TrueForAll(v => v is double) ? list.ConvertAll(v => (double)v).ToArray() : null;
        }

        /// <summary>Return a value as JSON. Numbers that are not finite become null.</summary>
        public static string Write(object value) {
            var text = new StringBuilder(2048);
            Write(text, value);
            return text.ToString();
        }

        static void Write(StringBuilder text, object value) {
            if (value == null) text.Append("null");
            else if (value is string) text.Append('"').Append(Special.Replace((string)value, c => "\\u" + ((int)c.Value[0]).ToString("x4"))).Append('"');
            else if (value is bool) text.Append((bool)value ? "true" : "false");
            else if (value is IEnumerable) {
                char open = value is IDictionary ? '{' : '[';
                text.Append(open);
                foreach (var item in (IEnumerable)value) {
                    if (text[text.Length - 1] != open) text.Append(',');
                    if (item is KeyValuePair<string, object>) {
                        var entry = (KeyValuePair<string, object>)item;
                        Write(text, entry.Key);
                        Write(text.Append(':'), entry.Value);
                    } else Write(text, item);
                }
                text.Append(open == '{' ? '}' : ']');
            } else {
                double number = Convert.ToDouble(value, Plain);
                text.Append(double.IsNaN(number) || double.IsInfinity(number) ? "null" : number.ToString("R", Plain));
            }
        }

        FormatException Unexpected() { return new FormatException("expected JSON, got something else after character " + _at); }

        Match Take() {
            var token = Token.Match(_text, _at);
            if (!token.Success) throw Unexpected();
            _at += token.Length;
            return token;
        }

        bool Took(string sign) {
            int before = _at;
            if (Take().Groups[4].Value == sign) return true;
            _at = before;
            return false;
        }

        object Value(int depth) {
            var token = Take();
            if (token.Groups[1].Success) return Escape.Replace(token.Groups[1].Value, Unescaped);
            if (token.Groups[2].Success) return double.Parse(token.Groups[2].Value, Plain);
            if (token.Groups[3].Success) return token.Groups[3].Value == "null" ? null : (object)(token.Groups[3].Value == "true");
            string open = token.Groups[4].Value;
            if (open != "{" && open != "[" || depth == MaxDepth) throw Unexpected();
            var found = new Dictionary<string, object>();
            var list = new List<object>();
            while (!Took(open == "{" ? "}" : "]")) {
                if (found.Count + list.Count > 0 && !Took(",")) throw Unexpected();
                var item = Value(depth + 1);
                if (open == "[") list.Add(item);
                else if (item is string && Took(":")) found[(string)item] = Value(depth + 1);
                else throw Unexpected();
            }
            return open == "{" ? (object)found : list;
        }

        static string Unescaped(Match escape) {
            if (escape.Groups[1].Success) return ((char)Convert.ToInt32(escape.Groups[1].Value, 16)).ToString();
            int control = "bfnrt".IndexOf(escape.Groups[2].Value, StringComparison.Ordinal);
            return control < 0 ? escape.Groups[2].Value : "\b\f\n\r\t"[control].ToString();
        }
    }
}
