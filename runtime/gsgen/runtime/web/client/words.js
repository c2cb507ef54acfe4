/** Words of messages: values as they are written, and the word that a misspelt one stands for. */

const MOST_EDITS = 2;
const LETTERS_PER_EDIT = 3; // of a word; short words are misspelt by fewer letters

/**
 * Return the known word that is nearest to a misspelt one; undefined if none is near.
 * @param {string} word
 * @param {string[]} words
 */
export function nearestWord(word, words) {
  const plain = (each) => each.toLowerCase().replaceAll(/[-_\s]/g, "");
  const limit = Math.min(MOST_EDITS, Math.floor(plain(word).length / LETTERS_PER_EDIT));
  const known = words.map((each) => ({ each, edits: editsBetween(plain(word), plain(each)) }));
  return known.sort((a, b) => a.edits - b.edits).find(({ edits }) => edits <= limit)?.each;
}

/** Return what helps where a word is none of some. @param {string[]} words */
export function hintAmong(word, words, subject = "It has") {
  const nearest = nearestWord(word, words);
  return nearest ? `Is ${nearest} meant?` : `${subject} ${words.join(", ") || "none"}.`;
}

/** Return how many letters are inserted, removed or replaced at least (Levenshtein 1966). */
function editsBetween(first, second) {
  let row = Array.from({ length: second.length + 1 }, (_, index) => index);
  for (let i = 0; i < first.length; i++) {
    const next = [i + 1];
    for (let j = 0; j < second.length; j++) {
      next.push(Math.min(row[j] + Number(first[i] !== second[j]), row[j + 1] + 1, next[j] + 1));
    }
    row = next;
  }
  return row[second.length];
}

/** Return a value as code writes it. @param {any} value */
export function written(value) {
  return typeof value === "number" ? String(value) : (JSON.stringify(value) ?? String(value));
}

/** Return the numbers of a text, between commas or spaces; NaN stands for other words. @param {string} text */
export function numbersIn(text) {
  return text.trim().split(/\s*,\s*|\s+/).map((word) => (word ? Number(word) : NaN));
}
