import "gsgen";
import { createElement, useState } from "react";
import { createRoot } from "react-dom/client";

function Page() {
  const [angle, setAngle] = useState(70);
  window.narrow = () => setAngle(30);
  const count = () => (window.loads = (window.loads ?? 0) + 1);
  return createElement("gsgen-model", {
    src: "/knot.spz", fieldOfView: angle, loading: "eager", cameraControls: true, autoplay: false, onload: count,
  });
}

createRoot(document.getElementById("root")).render(createElement(Page));
