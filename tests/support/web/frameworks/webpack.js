// Packs plain.js into the folder packed.

import webpack from "webpack";

const { pathname: path } = new URL("packed", import.meta.url);
const options = { mode: "production", entry: "./plain.js", output: { path }, optimization: { minimize: false }, performance: { hints: false } };
webpack(options, (error, stats) => {
  if (error) throw error;
  if (stats.hasErrors() || stats.hasWarnings()) throw new Error(stats.toString("errors-warnings"));
});
