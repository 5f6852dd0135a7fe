// Which results of a search come first: a page whose title has all words, most of all at its beginning, pages of use before reference and measurements, and excerpts of
// pages that are opened as files, which can fetch no other: the text is in EXCERPTS (conf.py).
const ASKED = (new URLSearchParams(location.search).get("q") || "").toLowerCase().split(/\s+/);
var Scorer = {
  score: ([page, title, anchor, description, score, file, kind]) =>
    score + (!anchor && ASKED.every(word => title.toLowerCase().includes(word)) ? 50 : 0)
    + (!anchor && title.toLowerCase().startsWith(ASKED.join(" ")) ? 20 : 0) - (page === "index" ? 40 : 0)
    - (kind === "object" || kind === "index" ? 60 : /^(results|architecture|reference|glossary|commands|files|studies)$/.test(page) ? 30 : 0),
  objNameMatch: 11, objPartialMatch: 6, objPrio: {0: 15, 1: 5, 2: -5}, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
};
const fetched = window.fetch.bind(window);
window.fetch = (address, ...rest) => {
  const text = EXCERPTS[String(address).replace(/^(\.\/)+/, "").split("#")[0]];
  if (text === undefined) return location.protocol === "file:" ? new Promise(() => {}) : fetched(address, ...rest);
  const main = document.createElement("div");
  main.setAttribute("role", "main");
  main.textContent = text;
  return Promise.resolve({text: () => Promise.resolve(main.outerHTML)});
};
