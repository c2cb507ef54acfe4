import "gsgen";

const model = document.querySelector("gsgen-model");
model.addEventListener("load", () => (window.loads = (window.loads ?? 0) + 1));
