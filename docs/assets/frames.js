// Figures that can be explored. The frames of a picture lie below one another, and a slider chooses the one that is
// shown. Figures of plotly are drawn when they come into view, with the plotly.js of this site, loaded once.
const assets = new URL(".", document.currentScript.src)
let plotly

function script() {
  plotly ??= new Promise((done, failed) => {
    const element = Object.assign(document.createElement("script"), { src: new URL("plotly.min.js", assets) })
    element.onload = done
    element.onerror = () => failed(new Error("plotly.js was not found"))
    document.head.append(element)
  })
  return plotly
}

// The colours of the scheme, light or dark, in place of those of the figure.
function colors(layout) {
  const style = getComputedStyle(document.body)
  const ink = style.getPropertyValue("--md-typeset-color"), line = "rgba(128, 128, 128, 0.35)"
  const changes = { paper_bgcolor: "rgba(0, 0, 0, 0)", plot_bgcolor: "rgba(0, 0, 0, 0)", "font.color": ink }
  Object.assign(changes, { "legend.bgcolor": "rgba(0, 0, 0, 0)", "modebar.bgcolor": "rgba(0, 0, 0, 0)" })
  const axes = { ...layout, xaxis: {}, yaxis: {} }
  for (const name of Object.keys(axes)) {
    if (/^[xy]axis\d*$/.test(name)) Object.assign(changes, { [`${name}.gridcolor`]: line, [`${name}.linecolor`]: ink })
    if (/^scene\d*$/.test(name))
      for (const axis of ["xaxis", "yaxis", "zaxis"])
        Object.assign(changes, { [`${name}.${axis}.showbackground`]: false, [`${name}.${axis}.gridcolor`]: line })
  }
  return changes
}

async function draw(element) {
  const [answer] = await Promise.all([fetch(element.dataset.figure), script()])
  const figure = await answer.json()
  // On a phone a scene is seen from farther away, so that it fits.
  if (element.clientWidth < 500)
    for (const scene of Object.values(figure.layout))
      if (scene?.camera?.eye) for (const axis of ["x", "y", "z"]) scene.camera.eye[axis] *= 1.7
  const options = { responsive: true, displaylogo: false }
  await Plotly.newPlot(element, figure.data, figure.layout, options)
  const recolor = () => Plotly.relayout(element, colors(figure.layout))
  await recolor()
  new MutationObserver(recolor).observe(document.body, { attributeFilter: ["data-md-color-scheme"] })
}

document$.subscribe(() => {
  for (const figure of document.querySelectorAll(".frames")) {
    const slider = figure.querySelector("input"), label = figure.querySelector("output")
    const frame = figure.querySelector(".frame"), labels = JSON.parse(figure.dataset.labels)
    const show = () => {
      frame.style.backgroundPositionY = `${(100 * slider.value) / Math.max(labels.length - 1, 1)}%`
      label.textContent = labels[slider.value]
    }
    slider.addEventListener("input", show)
    show()
  }
  const seen = new IntersectionObserver(entries => {
    for (const { target } of entries.filter(entry => entry.isIntersecting)) {
      seen.unobserve(target)
      draw(target).catch(error => { target.textContent = `The figure could not be drawn: ${error.message}` })
    }
  }, { rootMargin: "300px" })
  document.querySelectorAll(".plotly-figure").forEach(figure => seen.observe(figure))
})
