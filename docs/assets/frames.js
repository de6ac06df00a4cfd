// Figures with a slider: the frames of a picture lie below one another, and the slider chooses the one that is shown.
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
})
