import { GsgenError, type GsgenModel } from "gsgen";

const model: GsgenModel = document.createElement("gsgen-model");
model.src = "knot.spz";
model.fieldOfView = 40;
model.mode = "depth";
model.inputs = { speed: 2 };
model.orbit = { azimuth: 30, elevation: 20, radius: 4, target: [0, 0, 0], fieldOfView: 50 };
model.style.width = "10rem";
const blob: Blob = await model.toBlob({ width: 640, height: 360 });
const hit = await model.pick(10, 10);
const point: number[] | undefined = hit?.point;
const box: { min: number[]; max: number[] } | null = model.getBoundingBox();
const shown: GsgenModel = await model.ready;
const state: "empty" | "loading" | "ready" | "failed" = model.state;
model.ready.catch((error: GsgenError) => error.hint);
console.log(blob, point, box, shown, state);
