# Analyse studies by R: Rscript r_figures.R N.csv ...; each N.csv becomes N.json.
# The transform is reimplemented here; tests and contrasts are those of aov, car, lme4 with pbkrtest, and emmeans.
suppressPackageStartupMessages({library(lme4); library(car); library(emmeans); library(pbkrtest); library(jsonlite)})
options(contrasts = c("contr.sum", "contr.poly"))
emm_options(lmer.df = "kenward-roger", pbkrtest.limit = 1e5)

align <- function(d, factors, effect) {
  mean_of <- function(fs) if (length(fs)) ave(d$y, interaction(d[fs], drop = TRUE)) else rep(mean(d$y), nrow(d))
  out <- d$y - mean_of(factors)
  for (k in 0:length(effect)) for (s in combn(length(effect), k, simplify = FALSE))
    out <- out + (-1)^(length(effect) - k) * mean_of(effect[s])
  out
}
ranks <- function(x) rank(round(x / max(abs(x), 1e-300), 9))

for (path in commandArgs(TRUE)) {
  d <- read.csv(path, colClasses = "character")
  d$y <- as.numeric(d$y)
  d <- d[!is.na(d$y), ]
  factors <- setdiff(names(d), c("participant", "y"))
  d[c("participant", factors)] <- lapply(d[c("participant", factors)], factor)
  inside <- factors[sapply(factors, function(f) any(rowSums(table(d$participant, d[[f]]) > 0) > 1))]
  outside <- setdiff(factors, inside)
  persons <- unique(d[c("participant", outside)])
  cells <- prod(vapply(inside, function(f) nlevels(d[[f]]), 0))
  complete <- nrow(d) == nrow(persons) * cells
  equal <- !length(outside) || length(unique(as.vector(table(persons[outside])))) == 1
  effects <- unlist(lapply(1:length(factors), function(k) combn(factors, k, simplify = FALSE)), recursive = FALSE)
  out <- list(rm = list(), mixed = list(), rm_contrasts = list(), mixed_contrasts = list())
  add <- function(where, effect, numbers) out[[where]][[paste(effect, collapse = ":")]] <<- unname(signif(numbers, 9))
  quiet <- function(e) tryCatch(suppressWarnings(suppressMessages(e)), error = function(x) { message(path, ": ", conditionMessage(x)); NULL })

  for (effect in effects) {
    name <- paste(effect, collapse = ":")
    d$r <- ranks(align(d, factors, effect))
    if (sd(d$r) == 0) next
    right <- paste(factors, collapse = "*")
    if (complete && !length(inside)) {
      a <- quiet(Anova(lm(as.formula(paste("r ~", right)), d), type = 3))
      if (!is.null(a)) add("rm", effect, c(a[name, "F value"], a[name, "Df"], a["Residuals", "Df"], a[name, "Pr(>F)"]))
    } else if (complete && equal) {
      a <- quiet(summary(aov(as.formula(paste("r ~", right, "+ Error(participant/(", paste(inside, collapse = "*"), "))")), d)))
      for (part in a) {
        t <- part[[1]]; rownames(t) <- trimws(rownames(t))
        if (name %in% rownames(t)) add("rm", effect, c(t[name, "F value"], t[name, "Df"], t["Residuals", "Df"], t[name, "Pr(>F)"]))
      }
    } else if (complete) {
      wide <- d[do.call(order, d[c("participant", rev(inside))]), ]
      Y <- matrix(wide$r, ncol = cells, byrow = TRUE)
      who <- wide[!duplicated(wide$participant), outside, drop = FALSE]
      idata <- wide[1:cells, inside, drop = FALSE]
      m <- lm(as.formula(paste("Y ~", paste(outside, collapse = "*"))), who)
      a <- quiet(summary(Anova(m, idata = idata, idesign = as.formula(paste("~", paste(inside, collapse = "*"))), type = 3),
                         multivariate = FALSE)$univariate.tests)
      key <- paste(c(effect[effect %in% outside], effect[effect %in% inside]), collapse = ":")
      if (!is.null(a) && key %in% rownames(a))
        add("rm", effect, c(a[key, "F value"], a[key, "num Df"], a[key, "den Df"], a[key, "Pr(>F)"]))
    }
    if (length(inside)) {
      a <- quiet(Anova(lmer(as.formula(paste("r ~", right, "+ (1|participant)")), d,
                            control = lmerControl(optCtrl = list(xtol_abs = 1e-12, ftol_abs = 1e-14))), type = 3, test = "F"))
      if (!is.null(a)) add("mixed", effect, c(a[name, "F"], a[name, "Df"], a[name, "Df.res"], a[name, "Pr(>F)"]))
    }
    if (!name %in% c(factors[1], paste(factors[1:2], collapse = ":"))) next  # contrasts of two effects suffice
    # ART-C: the effect's factors as one
    others <- setdiff(factors, effect)
    e <- d
    e$cat <- interaction(d[effect], sep = ",", lex.order = TRUE)
    e$r <- ranks(align(e, c("cat", others), "cat"))
    right <- paste(c("cat", others), collapse = "*")
    pairs_of <- function(m) { s <- as.data.frame(summary(contrast(emmeans(m, ~cat), "pairwise", adjust = "holm"))); s[1:min(3, nrow(s)), ] }
    rows <- function(s) as.vector(t(as.matrix(s[, c("estimate", "SE", "df", "t.ratio")])))
    if (length(inside)) {
      s <- quiet(pairs_of(lmer(as.formula(paste("r ~", right, "+ (1|participant)")), e,
                               control = lmerControl(optCtrl = list(xtol_abs = 1e-12, ftol_abs = 1e-14)))))
      if (!is.null(s)) add("mixed_contrasts", effect, rows(s))
    }
    if (complete && !length(inside)) {
      s <- quiet(pairs_of(lm(as.formula(paste("r ~", right)), e)))
      if (!is.null(s)) add("rm_contrasts", effect, rows(s))
    } else if (complete && equal && (all(effect %in% outside) || all(effect %in% inside))) {
      # emmeans of aov is biased for effects that span strata (its documentation warns); lmer's is right there
      own <- if (any(effect %in% inside) && all(effect %in% inside)) "cat" else NULL
      stratum <- paste(c(own, setdiff(inside, effect)), collapse = "*")
      error <- if (nchar(stratum)) paste0("Error(participant/(", stratum, "))") else "Error(participant)"
      s <- quiet(pairs_of(aov(as.formula(paste("r ~", right, "+", error)), e)))
      if (!is.null(s)) add("rm_contrasts", effect, rows(s))
    }
  }
  write(toJSON(out, digits = NA, auto_unbox = FALSE), sub("csv$", "json", path))
}
