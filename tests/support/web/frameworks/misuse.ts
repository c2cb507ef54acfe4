import "gsgen";

const model = document.createElement("gsgen-model");
model.fieldOfView = "wide";
model.mode = "wireframe";
model.loop = 1;
model.currentTime = "end";
model.pick(1);
model.toBlob({ size: 3 });
model.background();
model.fov = 3;
model.addEventListener("warning", ({ detail }) => detail.loaded);
