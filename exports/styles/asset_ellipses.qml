<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="Symbology|MapTips">
<renderer-v2 type="singleSymbol" symbollevels="0" enableorderby="0" forceraster="0">
<symbols>
<symbol type="fill" name="0" alpha="1" force_rhr="0"><layer class="SimpleFill" enabled="1" locked="0" pass="0"><Option type="Map"><Option name="color" value="215,25,28,25" type="QString"/><Option name="style" value="solid" type="QString"/><Option name="outline_color" value="215,25,28,255" type="QString"/><Option name="outline_width" value="0.45" type="QString"/><Option name="outline_width_unit" value="MM" type="QString"/><Option name="outline_style" value="solid" type="QString"/></Option></layer></symbol>
</symbols>
</renderer-v2>
<mapTip>&lt;b>[% "name" %]&lt;/b>&lt;br/>holds the place with a probability of [% "conf" %]</mapTip>
</qgis>
