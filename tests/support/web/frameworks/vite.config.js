import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig } from "vite";

export default defineConfig({
  plugins: [svelte({ configFile: false })],
  build: { target: "esnext", rollupOptions: { input: ["plain.html", "react.html", "svelte.html"] } },
  logLevel: "warn",
});
