(what, limit) => {
  // What is wrong with the page as it is drawn: [] if nothing.
  const shown = (node) => node.checkVisibility({ opacityProperty: true, visibilityProperty: true }) && node.getClientRects().length > 0;
  const texts = [...document.body.querySelectorAll("*")].filter((node) => shown(node) && [...node.childNodes].some((c) => c.nodeType === 3 && c.textContent.trim()));
  const probe = Object.assign(document.createElement("canvas"), { width: 1, height: 1 }).getContext("2d", { willReadFrequently: true });
  const read = new Map();
  const channels = (css) => {
    if (!read.has(css)) {
      probe.clearRect(0, 0, 1, 1);
      probe.fillStyle = css;
      probe.fillRect(0, 0, 1, 1);
      read.set(css, [...probe.getImageData(0, 0, 1, 1).data]);
    }
    return read.get(css);
  };
  const over = (top, below) => below.map((v, k) => (k < 3 ? (top[k] * top[3] + v * (255 - top[3])) / 255 : 255));
  const drawn = (node, text) => {
    // the colour behind a text, or of the text itself; what lies in a faded box is mixed with what is below
    const chain = [], faded = [];
    for (let n = node; n; n = n.parentElement) chain.unshift(n);
    let seen = [255, 255, 255, 255];
    for (const n of chain) {
      const { opacity, backgroundColor } = getComputedStyle(n);
      if (opacity < 1) faded.push([seen, Number(opacity)]);
      seen = over(channels(backgroundColor), seen);
    }
    if (text) seen = over(channels(getComputedStyle(node).color), seen);
    return faded.reduceRight((top, [below, o]) => top.map((v, k) => o * v + (1 - o) * below[k]), seen);
  };
  const light = (rgb) => rgb.slice(0, 3).map((v) => v / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)).reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  const name = (node) => `${node.tagName.toLowerCase()}.${node.className} "${node.textContent.trim().slice(0, 40)}"`;
  if (what === "contrast") {
    return texts.filter((node) => !node.classList.contains("self")).flatMap((node) => {
      const a = light(drawn(node, true)), b = light(drawn(node, false));
      const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
      return ratio < limit ? [`${ratio.toFixed(2)} ${name(node)}`] : [];
    });
  }
  if (what === "cut") {
    return texts.filter((node) => node.scrollWidth > node.clientWidth + 1 && node.clientWidth > 0 && getComputedStyle(node).overflowX !== "visible" && getComputedStyle(node).overflowX !== "auto").map(name);
  }
  if (what === "scroll bars") {
    return [document.scrollingElement, document.body].filter((node) => node.scrollHeight > innerHeight || node.scrollWidth > innerWidth).map(name);
  }
  return [...document.querySelectorAll("button, [role=gridcell], select, input")].filter(shown).flatMap((node) => {
    const { width, height } = node.getBoundingClientRect();
    const cell = node.getAttribute("role") === "gridcell"; // a matrix of eight is as wide as its panel
    return height < limit - 0.5 || (width < limit - 0.5 && !cell) ? [`${width.toFixed(0)}x${height.toFixed(0)} ${name(node)}`] : [];
  });
}
