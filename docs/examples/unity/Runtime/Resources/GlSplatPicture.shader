// A stereo pair on a quad an eye, each where its eye requested it. Straight alpha. For the built-in pipeline and URP, in
// single-pass instanced, multiview and multi-pass stereo: URP draws passes without a light mode, and sets UnityCG's matrices.
Shader "glsplat/Picture" {
    Properties {
        _Left ("Left", 2D) = "black" {}
        _LeftAlpha ("Left alpha", 2D) = "black" {}
        _Right ("Right", 2D) = "black" {}
        _RightAlpha ("Right alpha", 2D) = "black" {}
        _Opaque ("Without alpha", Float) = 0
    }
    SubShader {
        Tags { "Queue" = "Transparent" "RenderType" = "Transparent" }
        Pass {
            Cull Off
            ZWrite Off
            Blend SrcAlpha OneMinusSrcAlpha, One OneMinusSrcAlpha
            CGPROGRAM
            #pragma vertex vert
            #pragma fragment frag
            #pragma multi_compile_instancing
            #include "UnityCG.cginc"

            sampler2D _Left, _LeftAlpha, _Right, _RightAlpha;
            float4 _Corners[8]; // in the object's space: of the left eye, of the right; from the lower left, row by row
            float _Opaque;

            struct Input {
                float4 share : POSITION; // of the picture, from the lower left
                UNITY_VERTEX_INPUT_INSTANCE_ID
            };

            struct Varying {
                float4 position : SV_POSITION;
                float2 share : TEXCOORD0;
                UNITY_VERTEX_OUTPUT_STEREO
            };

            Varying vert(Input v) {
                Varying o;
                UNITY_SETUP_INSTANCE_ID(v);
                UNITY_INITIALIZE_OUTPUT(Varying, o);
                UNITY_INITIALIZE_VERTEX_OUTPUT_STEREO(o);
                int corner = 4 * unity_StereoEyeIndex + (int)(v.share.x + 2 * v.share.y + 0.5);
                o.position = UnityObjectToClipPos(float4(_Corners[corner].xyz, 1));
                o.share = v.share.xy;
                return o;
            }

            fixed4 frag(Varying i) : SV_Target {
                UNITY_SETUP_STEREO_EYE_INDEX_POST_VERTEX(i);
                bool right = unity_StereoEyeIndex > 0;
                fixed3 colour = right ? tex2D(_Right, i.share).rgb : tex2D(_Left, i.share).rgb;
                fixed alpha = right ? tex2D(_RightAlpha, i.share).r : tex2D(_LeftAlpha, i.share).r;
                #ifndef UNITY_COLORSPACE_GAMMA // the sampler took the alpha for a colour
                alpha = LinearToGammaSpaceExact(alpha);
                #endif
                return fixed4(colour, max(alpha, _Opaque));
            }
            ENDCG
        }
    }
}
