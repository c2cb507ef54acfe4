// What a server does that renders pages with the element: import the package, which has no document.

import { GsgenError, GsgenModel } from "gsgen";
import * as element from "gsgen/element";
import plans from "gsgen/plans.json" with { type: "json" };
import { createElement } from "react";
import { renderToString } from "react-dom/server";

const html = renderToString(createElement("gsgen-model", { src: "knot.spz", "camera-controls": "" }));
const same = element.GsgenModel === GsgenModel;
console.log(JSON.stringify([html, same, typeof GsgenError, plans.plans.length > 0]));
