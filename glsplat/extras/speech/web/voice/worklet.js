// Audio thread: turns the microphone's sound into weights. The sound itself stays in this thread.

import { Analysis, Mouth } from './analysis.js';

class Listener extends AudioWorkletProcessor {
  #analysis;
  #mouth;

  constructor({ processorOptions: { table } }) {
    super();
    this.#analysis = new Analysis(table, sampleRate);
    this.#mouth = new Mouth(table);
  }

  process([[samples]]) {
    let weights = null;
    for (const frame of samples ? this.#analysis.add(samples) : []) weights = this.#mouth.add(frame);
    if (weights) this.port.postMessage(weights);
    return true;
  }
}

registerProcessor('listener', Listener);
