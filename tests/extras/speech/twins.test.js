import { readFileSync } from 'node:fs';
import { bytesOf, check } from './twins.js';
import { Analysis, Mouth } from './voice/analysis.js';

const table = JSON.parse(readFileSync(new URL('voice/visemes.json', import.meta.url)));

check({
  heard({ rate, piece, samples }) {
    const sound = Float64Array.from(new Int16Array(bytesOf(samples).buffer), (value) => value / 2 ** 15);
    const [analysis, mouth] = [new Analysis(table, rate), new Mouth(table)];
    const out = [];
    for (let first = 0; first < sound.length; first += piece) {
      for (const frame of analysis.add(sound.subarray(first, first + piece))) {
        out.push([frame.time, frame.level, ...frame.visemes, ...Object.values(mouth.add(frame))]);
      }
    }
    return out;
  },
});
