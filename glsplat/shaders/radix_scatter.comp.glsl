// Moves each splat to the start of its digit and group plus its rank there. A tile is sorted in shared memory first, so
// that neighbouring threads write neighbouring places.
layout(local_size_x = 256) in;
#include "radix.glsl"

const uint LANES = 32u;  // threads of a segment, a bit each; a segment ranks an eighth of a tile
const uint SEGMENTS = THREADS / LANES;
const uint ROW = 1024u;  // splats of a row of the arena
const uint NONE = 0xFFFFFFFFu;  // index of a culled splat, and beyond the span

shared uint first[TILE];   // [segment][digit]: lanes with the digit; then the depths of the sorted tile
shared uint second[TILE];  // [segment][digit]: splats with the digit so far; then the indices of the sorted tile
shared uint sums[DIGITS];
shared uint offsets[DIGITS];  // of a digit: place in the output less place in the tile
shared uint filled;           // splats of the tile

// Return the sum of the values of the threads before t: sums within blocks of 16, then of the blocks before.
uint sum_before(uint t, uint value) {
    sums[t] = value;
    sync();
    if (t < DIGITS / 16u) {
        for (uint i = 16u * t + 1u; i < 16u * t + 16u; ++i) sums[i] += sums[i - 1u];
    }
    sync();
    uint before = sums[t] - value;
    for (uint i = 15u; i < t; i += 16u) before += sums[i];
    sync();
    return before;
}

void main() {
    uint t = gl_LocalInvocationIndex, lane = t % LANES, row = t / LANES * DIGITS, last = last_digit();
    if (digit > last) return;
    uint total = 0u, earlier = 0u;  // of digit t: in all groups, and in those before this one
    for (uint group = 0u; group < groups; ++group) {
        uint found = histogram[group * DIGITS + t];
        total += found;
        earlier += group < gl_WorkGroupID.x ? found : 0u;
    }
    uint next = sum_before(t, total) + earlier;
    uvec2 span = group_span();
    uint read = list_of(digit - 1u), write = list_of(digit);
    for (uint tile = span.x; tile < span.y; tile += TILE) {
        uint depths[ROUNDS], indices[ROUNDS], ranks[ROUNDS];  // zink of Mesa 22.3 compiles no array of bool
        for (uint r = 0u; r < ROUNDS; ++r) {  // all loads first, so that they are under way together
            uint i = tile + t / LANES * LANES * ROUNDS + r * LANES + lane;
            depths[r] = 0u;
            indices[r] = NONE;
            if (i < span.y && digit == 0u) {
                uint shown = shown_at(i), key = scratch[3u * shown];
                depths[r] = depth_of(key);
                if (key < FIRST_CULLED) indices[r] = rows[shown / ROW] * ROW + shown % ROW;
            } else if (i < span.y) {
                depths[r] = scratch[read + i];
                indices[r] = scratch[read + count + i];
            }
            first[r * THREADS + t] = 0u;
            second[r * THREADS + t] = 0u;
        }
        sync();
        for (uint r = 0u; r < ROUNDS; ++r) {
            uint at = row + digit_of(depths[r]);
            if (indices[r] != NONE) atomicOr(first[at], 1u << lane);
            sync();
            uint same = first[at], before = second[at];
            ranks[r] = before + uint(bitCount(same & ((1u << lane) - 1u)));
            sync();
            if (indices[r] != NONE && same >> lane == 1u) {  // the last lane with this digit
                first[at] = 0u;
                second[at] = before + uint(bitCount(same));
            }
            sync();
        }
        uint found = 0u;
        for (uint s = 0u; s < SEGMENTS; ++s) found += second[s * DIGITS + t];
        uint start = sum_before(t, found), place = start;
        for (uint s = 0u; s < SEGMENTS; ++s) {
            uint here = second[s * DIGITS + t];
            second[s * DIGITS + t] = place;
            place += here;
        }
        offsets[t] = next - start;
        if (t == DIGITS - 1u) filled = place;
        next += found;
        sync();
        for (uint r = 0u; r < ROUNDS; ++r) ranks[r] += second[row + digit_of(depths[r])];
        sync();
        for (uint r = 0u; r < ROUNDS; ++r) {
            if (indices[r] != NONE) {
                first[ranks[r]] = depths[r];
                second[ranks[r]] = indices[r];
            }
        }
        sync();
        for (uint j = t; j < filled; j += THREADS) {
            uint depth = first[j], to = offsets[digit_of(depth)] + j;
            if (digit == last) {
                order[to] = second[j];
            } else {
                scratch[write + to] = depth;
                scratch[write + count + to] = second[j];
            }
        }
        sync();
    }
}
