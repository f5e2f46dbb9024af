// Buffers of the radix sort (twin: renderer/gpu_sort.py): 4 bits per pass, stable, and deterministic, as no atomic
// decides an order. It uses shared memory, because drivers lack subgroup operations or differ in their width.
layout(std430, binding = 0) buffer Keys { uint keys[]; };
layout(std430, binding = 1) buffer Order { uint order[]; };
layout(std430, binding = 2) buffer Scratch { uint scratch[]; };  // keys, then order, of the odd passes
layout(std430, binding = 3) buffer Histogram { uint histogram[]; };  // digit-major: [16][groups]

uniform uint count;
uniform uint groups;
uniform uint shift;
uniform bool odd;  // this pass reads the scratch and writes the keys

const uint THREADS = 64u;
const uint RUN = 16u;  // consecutive elements per thread, which keeps their order
const uint BLOCK = THREADS * RUN;

uint load_key(uint i) { return odd ? scratch[i] : keys[i]; }
uint load_order(uint i) { return odd ? scratch[count + i] : order[i]; }
uint digit_of(uint key) { return (key >> shift) & 15u; }
