// The page's questionnaire against a server: node questions_page.mjs FOLDER ORIGIN SECRET TOKEN
// Gives an answer to "mental" for each number on standard input, and prints what the page has once all is sent.
const [folder, origin, secret, token] = process.argv.slice(2);
const kept = new Map();
globalThis.location = { href: `${origin}/vr/study.html`, hash: '', search: '', pathname: '/vr/study.html' };
globalThis.sessionStorage = { getItem: (key) => kept.get(key) ?? null, setItem: (key, value) => kept.set(key, value) };
const { Link } = await import(`${folder}/link.js`);
const { Questions } = await import(`${folder}/questions.js`);

const page = '0123456789abcdef';
const link = new Link({ secret, token });
const troubles = [];
let sent = 0;
const questions = new Questions(async (message) => {
  sent += 1;
  const state = await link.ask('study/do', { page, ...message });
  questions.told(state);
  return state;
});
questions.addEventListener('change', () => {
  if (questions.trouble && troubles.at(-1) !== questions.trouble) troubles.push(questions.trouble);
});
questions.told(await link.ask('study/do', { page, do: 'enter' }));
for (const value of JSON.parse(process.argv[6])) {
  questions.index = questions.items.findIndex(({ name }) => name === 'mental');
  questions.choose(value);
  while (questions.saving) await new Promise((done) => setTimeout(done, 20));
}
const { answers, refused } = questions;
console.log(JSON.stringify({ answers, refused, troubles, sent, unsaved: JSON.parse([...kept.values()][0] ?? '[]') }));
